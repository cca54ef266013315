/* Side channel of the simulated libHD: what a test, a script or a program asks of the simulated
 * device beside HDAPI itself. SI units; device frame of HDAPI (x right, y up, z to the operator). */
#ifndef CARDAN_OMNI_SIM_H
#define CARDAN_OMNI_SIM_H

#include <stdint.h>

#define SIM_API __attribute__((visibility("default")))

/* The device's true state at the end of the newest tick. */
typedef struct {
    double time_s;            /* the library's clock: CLOCK_MONOTONIC, or virtual from 0 */
    uint64_t ticks;
    double position_m[3];     /* true, gimbal center; not quantized */
    double velocity_m_s[3];
    double hand_target_m[3];
    double hand_force_n[3];   /* of the hand on the stylus */
    double commanded_n[3];    /* what end-frame carried last */
    double delivered_n[3];    /* what the motors exert after clamp, ramp, amplifier and DAC */
    double delivered_j;       /* work of the motors on the stylus since the start (ground truth) */
    double hand_j;            /* work of the hand on the stylus, of simPush and of the droop */
    double lost_j;            /* work lost in friction, damping and stops of the mechanism */
    double kinetic_j;         /* of the stylus: delivered_j + hand_j = lost_j + kinetic_j */
    double temperature[3];
    int32_t buttons;
    int32_t docked;
    int32_t gripped;
    int32_t amplifier;        /* 1: force goes out */
    int32_t calibrated;
    int32_t script_done;      /* 1: the last waypoint is over */
} SimTruth;

/* Forget everything, take these settings (text, a "key values..." line each; see settings.py) and
 * be as just powered on. NULL or "": the defaults. Returns 0, or -1: simProblem() says what is
 * wrong, which may be that the log cannot be written, and nothing has changed. Must be called while no device is initialized. Without a call
 * the first hdInitDevice takes the settings from the file that CARDAN_OMNI names, if any. */
SIM_API int simConfigure(const char *settings);
SIM_API const char *simProblem(void);

/* Run so many ticks now, in the caller's thread. Only with "clock virtual" and a started
 * scheduler; returns how many were run. */
SIM_API int simStep(int ticks);
SIM_API double simNow(void);
SIM_API void simTruth(SimTruth *truth);

/* The hand, at once: target (m) and orientation (rad: rotation about x, y, z in turn), whether it
 * grips, how hard it pushes beside its spring (N), the buttons' levels, and whether the stylus is
 * put into the inkwell. Ends the script. */
SIM_API void simHand(const double target_m[3], const double turn_rad[3], int gripped,
                     const double push_n[3], int buttons, int docked);

/* A force of the world on the stylus beside the hand (N), until the next call: an impulse, a
 * neighbor's elbow. */
SIM_API void simPush(const double force_n[3]);

/* A fault by name, from now on; value 0 ends it. Returns -1 for a name there is not. */
SIM_API int simFault(const char *name, double value);

#endif
