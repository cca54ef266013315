/* The callback for libHD's scheduler thread: reads the device, steps the tick, sends the force.
 *
 * Everything that is particular to the Omni and to HDAPI is here: mm and its device frame (x
 * right, y up, z to the operator) on one side, m and the hand frame on the other, the kinematics,
 * and what each of the library's errors means. */
#ifndef CARDAN_OMNI_HD_SERVO_H
#define CARDAN_OMNI_HD_SERVO_H

#include "hdapi.h"
#include "tick.h"

/* libHD's functions by address: it is loaded at run time. */
typedef struct {
    void (*begin_frame)(HHD device);
    void (*end_frame)(HHD device);
    void (*get_booleanv)(HDenum name, HDboolean *values);
    void (*get_integerv)(HDenum name, HDint *values);
    void (*get_doublev)(HDenum name, HDdouble *values);
    void (*get_longv)(HDenum name, HDlong *values);
    void (*set_doublev)(HDenum name, const HDdouble *values);
    HDenum (*check_calibration)(void);
    HDErrorInfo (*get_error)(void);
} ServoFunctions;

typedef struct Servo Servo;

/* clock: seconds, or NULL for CLOCK_MONOTONIC. joint_torque: drive by joint torques. realtime:
 * ask for SCHED_FIFO at the first tick. NULL: no memory. */
CARDAN_API Servo *servo_create(Tick *tick, const ServoFunctions *functions, HHD device,
                               int joint_torque, double (*clock)(void), int realtime);
CARDAN_API void servo_destroy(Servo *servo);

/* The next tick sends no force and asks for no more. */
CARDAN_API void servo_stop(Servo *servo);

CARDAN_API HDCallbackCode servo_callback(void *servo);

/* Position by joint angles (hand frame, m/rad, row by row; m where it is not NULL). */
CARDAN_API void omni_kinematics(const double joints_rad[3], double position[3],
                                double jacobian[9]);

#endif
