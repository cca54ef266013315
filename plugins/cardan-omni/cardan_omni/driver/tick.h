/* The law of the force feedback: one step per tick of the haptic device's own loop.
 *
 * Pure C11: no library of a device, no clock (time is an argument), no allocation and no lock in
 * the step. SI units; hand frame (x forward, y left, z up, m) unless a name says world.
 *
 * Threads. tick_begin, tick_step, tick_error and tick_fatal belong to the device's thread. tick_command
 * and tick_set_limits belong to one other thread at a time, tick_snapshot too; tick_request to any.
 * All three exchanges are triple buffers: the writer fills a buffer of its own and swaps it with
 * the middle one, the reader swaps the middle one with its own. Neither waits, and nothing is
 * ever read that is half written.
 *
 * Order in a step. Work of the force sent last -> velocity -> faults and whatever forbids force ->
 * the commanded force (fixtures, measured force, plain force, workspace edge) -> engage ramp,
 * oscillation gain -> damping -> alpha of the passivity controller -> thermal derating and norm clamp ->
 * slew limit -> energy tank. What forbids force makes the target zero, and the force falls there
 * along its own direction at slew_fall_n_s >= clamp_n / release_s: so within release_s.
 *
 * The energy bound. With x_k the position as measured at tick k, d_k = x_k - x_(k-1) and F_k the
 * force sent at tick k (held until k+1), the work given to the hand is sum F_(k-1) . d_k if the
 * measurement is of this instant, and sum F_(k-2) . d_k if it is a tick old, as a library's is that
 * latches what the packet before brought. Which of the two is not known, so the worse is booked:
 *     W -= max(F_(k-1) . d_k, F_(k-2) . d_k);
 * W is kept below 50 mJ, and while no force is asked for (below 0.1 N) it does not grow above zero
 * and leaks away, but by neither so far that E < R(F). The tank is E = W + energy_budget_j. A force F
 * is only sent if no more than E could be booked for it, and for the force before it, while it falls
 * to zero at the slew limit from the very next tick on, should the hand accelerate along F as hard
 * as believed: with G the force before, a_j = max(0, |F| - j s), s = slew_fall_n_s * period,
 * e = prediction_error_m, v = F/|F| . d_k,
 *     R(F) = max(|F| (v + e), G . d_k + |G| e)
 *          + sum_(j>=1, a_(j-1) > 0) max(a_(j-1) (v + (j+1) e), a_j (v + (j+1) e))  <=  max(E, 0).
 * If that held for F_k, then it holds at k+1 for F_k shortened by s, whatever the hand did, as long
 * as |d_(k+1) - d_k| <= e; so there is always a force that is both within the slew limit and
 * allowed, and by induction E never falls below zero. Therefore, from each engagement on,
 *     net energy given to the hand  <=  energy_budget_j + c * sum_k max(0, |d_(k+1) - d_k| - e)
 * with c = clamp_n * (m + 3) / 2, m = ceil(clamp_n / s) (8 J per m, or 8 mJ per mm, by default).
 * The sum is zero while the hand accelerates less than e / period^2 (100 m/s^2 by default). It
 * counts what was sent, after every limit, at a steady period, for positions as measured, in every
 * tick, that are at most one tick old; the encoders' quantum is not in it. Interruptions (silence,
 * late ticks, failed readings, a slow loop, motors off, PAUSED) do not touch W: force that comes back
 * after them is of the same engagement. An engagement (the command's `engaged`
 * rising, enable, resume) starts with W = 0. */
#ifndef CARDAN_OMNI_TICK_H
#define CARDAN_OMNI_TICK_H

#include <stddef.h>
#include <stdint.h>

#define CARDAN_API __attribute__((visibility("default")))

#define TICK_FIXTURES 8
#define TICK_BUTTONS 2
#define TICK_NEVER (-1e300)
#define TICK_PERIOD_S 1e-3

enum { TICK_DISABLED, TICK_ENABLED, TICK_PAUSED, TICK_FAULT };

enum { TICK_ENABLE, TICK_DISABLE, TICK_PAUSE, TICK_RESUME };

/* Why the force is not what was commanded. */
enum {
    TICK_AS_COMMANDED,
    TICK_NOT_ENABLED,
    TICK_PAUSED_ON_REQUEST,
    TICK_PAUSED_SILENT,
    TICK_PAUSED_LATE,
    TICK_PAUSED_IRREGULAR,
    TICK_PAUSED_OSCILLATION,
    TICK_FAULT_NOT_FINITE,
    TICK_FAULT_VELOCITY,
    TICK_FAULT_FORCE_ERRORS,
    TICK_FAULT_DEVICE,
    TICK_FAULT_READINGS,
    TICK_NO_OUTPUT,
    TICK_TOO_SLOW,
    TICK_NO_READING,
    TICK_UNCALIBRATED,
    TICK_DOCKED,
    TICK_NO_COMMAND,
    TICK_SILENT,
    TICK_NOT_ENGAGED,
    TICK_NOT_SMALL,
    TICK_ENGAGING,
    TICK_LATE,
    TICK_AFTER_FORCE_ERROR,
    TICK_OSCILLATION,
    TICK_PASSIVITY,
    TICK_THERMAL,
    TICK_CLAMPED,
    TICK_SLEWING
};

enum {
    TICK_SPHERE,
    TICK_PLANE,
    TICK_BOX,
    TICK_CYLINDER,
    TICK_SPRING,
    TICK_VISCOUS
};

/* Results of tick_command and tick_set_limits. */
enum {
    TICK_TAKEN,
    TICK_DROPPED,
    TICK_NOT_FINITE,
    TICK_NOT_A_ROTATION,
    TICK_TOO_MANY_FIXTURES,
    TICK_NOT_UNIT,
    TICK_NEGATIVE,
    TICK_BAD_LIMIT,
    TICK_OF_THE_FUTURE
};

typedef struct {
    double clamp_n;
    double slew_rise_n_s;
    double slew_fall_n_s;
    double release_s;
    double engage_ramp_s;
    double engage_below_n;
    double hold_s;
    double pause_s;
    double measured_hold_s;
    double velocity_gate_m_s;
    double damping_n_s_m;
    double velocity_cutoff_hz;
    double continuous_n;
    double continuous_window_s;
    double thermal_derating_s;
    double temperature_limit;
    double alpha_max_n_s_m;
    double energy_budget_j;
    double prediction_error_m;
    double leak_s;
    double workspace_lower_m[3];
    double workspace_upper_m[3];
    double edge_stiffness_n_m;
    double extrapolate_s;
    double overrun_gap_s;
    double pause_gap_s;
    double oscillation_window_s;
    double oscillation_speed_m_s;
    double force_error_wait_s;
    double torque_limit_n_m;
    double lowest_rate_hz;
    int32_t engage_ticks;
    int32_t oscillation_reversals;
    int32_t passivity;
    int32_t unchecked; /* of experiments: only what makes no sense is refused */
} TickLimits;

/* World frame. point: center, point or target; axis: normal, axis or half sides. */
typedef struct {
    int32_t kind;
    int32_t inside;
    double point[3];
    double axis[3];
    double rotation[9];
    double radius_m;
    double stiffness_n_m;
    double cap_n;
    double damping_n_s_m;
} TickFixture;

typedef struct {
    uint64_t sequence;
    double stamp_s;
    int32_t engaged;
    int32_t fixture_count;
    int32_t has_measured;
    int32_t has_torques;
    double linear[9];
    double offset[3];
    double rotation[9];
    double force[3];
    double force_scale;
    double torques_n_m[3];
    double measured_force[3];
    double measured_stamp_s;
    double measured_rate_n_s[3];
    double measured_position[3];
    double measured_stiffness_n_m;
    TickFixture fixtures[TICK_FIXTURES];
} TickCommand;

typedef struct {
    double now_s;
    double position[3];
    double velocity[3]; /* the library's own */
    double rotation[9];
    double joints_rad[3];
    double gimbal_rad[3];
    double jacobian[9]; /* of the position by the joints, m/rad, row by row */
    double temperature; /* hottest motor, 0..1 */
    double cost_s;      /* what the tick before took */
    int64_t encoders[6];
    int32_t buttons;
    int32_t inkwell;
    int32_t calibrated;
    int32_t calibration; /* the library's own word for it, published */
    int32_t by_torque;   /* the device is driven by joint torques, whatever was commanded */
    int32_t unsound;     /* readings failed: nothing in it counts but the time */
} TickSample;

typedef struct {
    double force[3];
    double torques_n_m[3]; /* the same as joint torques: transposed Jacobian, within the limit */
    int32_t torque_mode;   /* drive the device by these torques */
    int32_t state;
} TickOutput;

typedef struct {
    double stamp_s;
    uint64_t ticks;
    int32_t state;
    int32_t reason;
    double position[3];
    double velocity[3];
    double rotation[9];
    double joints_rad[3];
    double gimbal_rad[3];
    double force_commanded[3];
    double force[3];
    double torques_n_m[3];
    double energy_j;
    double delivered_j;
    double passivity_damping_n_s_m;
    double thermal_derating;
    double temperature;
    uint64_t command_sequence;
    double command_age_s;
    double force_age_s;
    double gap_s;
    double tick_cost_s;
    double rate_hz;
    int64_t encoders[6];
    int32_t buttons;
    int32_t inkwell;
    int32_t calibrated;
    int32_t calibration;
    uint32_t presses[TICK_BUTTONS];
    uint32_t late_ticks;
    uint32_t stale_commands;
    uint32_t faults;
    uint32_t oscillations;
    uint32_t errors;       /* of the library, all */
    uint32_t force_errors; /* of the library, 0x02xx */
    uint32_t error;        /* of the library, the newest */
    int32_t internal_error;
    int32_t realtime; /* 1: the thread has real-time scheduling; 0: it was refused; -1: not asked */
    int32_t finished; /* 1: the callback has said that it wants no more ticks */
    double peak_n;       /* largest force sent since the tick was made */
    double given_peak_j; /* most energy booked as given to the hand within one engagement */
    int32_t rendering;   /* 1: force is let out, in whole or on its ramp */
    uint32_t bad_readings; /* samples that were unsound */
} TickSnapshot;

typedef struct Tick Tick;

CARDAN_API Tick *tick_create(const TickLimits *limits); /* NULL: bad limits, or no memory */
CARDAN_API void tick_destroy(Tick *tick);
CARDAN_API int tick_set_limits(Tick *tick, const TickLimits *limits);

/* Checks and takes a command; the step sees it whole or not at all. A rejected one changes
 * nothing. Dropped: stamp before the last one's, or sequence not above the last one's within
 * pause_s of it (later it is another source, that counts anew). now_s: the time, where the caller
 * knows it; NaN: that of the newest tick counts, which may be a second old. A stamp that is ahead
 * of it is refused, and where that was not known yet the stamp does not stand in the way of later
 * ones. */
CARDAN_API int tick_command(Tick *tick, const TickCommand *command, double now_s);
CARDAN_API uint32_t tick_dropped(const Tick *tick);

/* CRTK's state commands; 0, or -1 where the state does not allow it. */
CARDAN_API int tick_request(Tick *tick, int verb);
/* From any thread: nothing steps it any more. FAULT, whatever the state was. */
CARDAN_API void tick_lose(Tick *tick);
/* From any thread: whether the motors are on. While they are not no force is asked for, and what
 * comes then engages anew, so that they are switched at zero force only. At first they are. */
CARDAN_API void tick_allow(Tick *tick, int allowed);
/* The state as it is now, before any step has seen it: state | reason << 8. */
CARDAN_API int tick_state(const Tick *tick);

/* From the device's thread, before its first step: what was sent before is gone, and where the
 * stylus was is no place that motion can be measured from. */
CARDAN_API void tick_begin(Tick *tick);
CARDAN_API void tick_step(Tick *tick, const TickSample *sample, TickOutput *output);

/* The newest snapshot, whole. The maxima in it are since the snapshot that was read before. */
CARDAN_API void tick_snapshot(Tick *tick, TickSnapshot *snapshot);

/* From the device's thread: an error the library told of, after the step of the same tick. */
CARDAN_API void tick_error(Tick *tick, uint32_t code, int32_t internal, double now_s);
/* The same, one that ends the loop: FAULT. */
CARDAN_API void tick_fatal(Tick *tick, uint32_t code, int32_t internal);
CARDAN_API void tick_set_realtime(Tick *tick, int realtime);
CARDAN_API void tick_set_finished(Tick *tick, int finished);

/* Sizes and offsets of every field above in order, for declarations in another language;
 * returns how many there are. */
CARDAN_API size_t tick_layout(const size_t **values);

#endif
