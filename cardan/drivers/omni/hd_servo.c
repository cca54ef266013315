#include "hd_servo.h"

#include <math.h>
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define TEMPERATURE_EVERY 16
#define FIFO_PRIORITY 20 /* above the robot's loop, which runs at 10 */
#define ERRORS_AT_ONCE 16

/* What a device may not have: asked for once, and not again if that gave an error. */
enum { HAS_VELOCITY = 1, HAS_GIMBAL = 2, HAS_ENCODERS = 4, HAS_TEMPERATURE = 8, HAS_INKWELL = 16 };

struct Servo {
    Tick *tick;
    ServoFunctions hd;
    HHD device;
    double (*clock)(void);
    bool realtime;
    _Atomic int stop;
    bool started;
    unsigned has;
    uint64_t ticks;
    TickSample sample;
};

static double monotonic(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* ---------------------------------------------------------------------------------------------
 * Frames. Hand axis i is device axis `axis[i]` times `sign[i]`. */

static const int axis[3] = {2, 0, 1};
static const double sign[3] = {-1.0, -1.0, 1.0};

static void to_hand(double hand[3], const double device[3], double factor)
{
    for (int i = 0; i < 3; i++)
        hand[i] = sign[i] * device[axis[i]] * factor;
}

static void to_device(double device[3], const double hand[3])
{
    for (int i = 0; i < 3; i++)
        device[axis[i]] = sign[i] * hand[i];
}

/* The rotation in a column-major transform, made orthonormal, in the hand frame. False: it is so
 * far from a rotation that there is none to be made of it; nothing has changed then. */
static bool rotation_to_hand(double hand[9], const double transform[16])
{
    double m[3][3]; /* rows */
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            m[i][j] = transform[4 * j + i];
    /* Newton's iteration towards the nearest rotation: m (3 - mT m) / 2. */
    for (int round = 0; round < 4; round++) {
        double product[3][3], next[3][3];
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                double sum = 0.0;
                for (int k = 0; k < 3; k++)
                    sum += m[k][i] * m[k][j];
                product[i][j] = (i == j ? 1.5 : 0.0) - 0.5 * sum;
            }
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                next[i][j] = 0.0;
                for (int k = 0; k < 3; k++)
                    next[i][j] += m[i][k] * product[k][j];
            }
        memcpy(m, next, sizeof m);
    }
    double worst = 0.0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double sum = 0.0;
            for (int k = 0; k < 3; k++)
                sum += m[i][k] * m[j][k];
            worst = fmax(worst, fabs(sum - (i == j)));
        }
    double determinant = m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) -
                         m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
                         m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
    if (!(worst < 1e-6) || !(determinant > 0.0))
        return false;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            hand[3 * i + j] = sign[i] * sign[j] * m[axis[i]][axis[j]];
    return true;
}

void omni_kinematics(const double joints_rad[3], double position[3], double jacobian[9])
{
    const double upper = 0.13335, lower = 0.13335, height = 0.02335, reach = 0.16835; /* m */
    double s1 = sin(joints_rad[0]), c1 = cos(joints_rad[0]);
    double s2 = sin(joints_rad[1]), c2 = cos(joints_rad[1]);
    double s3 = sin(joints_rad[2]), c3 = cos(joints_rad[2]);
    double r = upper * c2 + lower * s3;
    if (position) {
        double device[3] = {-r * s1, upper * s2 - lower * c3 + height, r * c1 - reach};
        to_hand(position, device, 1.0);
    }
    double rows[3][3] = {{-c1 * r, s1 * upper * s2, -s1 * lower * c3},
                         {0.0, upper * c2, lower * s3},
                         {-s1 * r, -c1 * upper * s2, c1 * lower * c3}};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            jacobian[3 * i + j] = sign[i] * rows[axis[i]][j];
}

/* --------------------------------------------------------------------------------------------- */

Servo *servo_create(Tick *tick, const ServoFunctions *functions, HHD device, int joint_torque,
                    double (*clock)(void), int realtime)
{
    Servo *servo = calloc(1, sizeof *servo);
    if (!servo)
        return NULL;
    servo->tick = tick;
    servo->hd = *functions;
    servo->device = device;
    servo->clock = clock ? clock : monotonic;
    servo->realtime = realtime != 0;
    servo->sample.by_torque = joint_torque != 0;
    servo->sample.rotation[0] = servo->sample.rotation[4] = servo->sample.rotation[8] = 1.0;
    return servo;
}

void servo_destroy(Servo *servo)
{
    free(servo);
}

void servo_stop(Servo *servo)
{
    atomic_store(&servo->stop, 1);
}

static bool ends_the_loop(HDerror code)
{
    return code == HD_DEVICE_FAULT || code == HD_COMM_ERROR || code == HD_TIMER_ERROR;
}

/* Empties the library's stack of errors; true if one of them ends the loop. */
static bool take_errors(Servo *servo, double now_s)
{
    for (int i = 0; i < ERRORS_AT_ONCE; i++) {
        HDErrorInfo error = servo->hd.get_error();
        if (error.errorCode == HD_SUCCESS)
            return false;
        if (ends_the_loop(error.errorCode)) {
            tick_fatal(servo->tick, error.errorCode, error.internalErrorCode);
            return true;
        }
        tick_error(servo->tick, error.errorCode, error.internalErrorCode, now_s);
    }
    return false;
}

static void ask_for_realtime(Servo *servo)
{
    int policy;
    struct sched_param parameters;
    if (pthread_getschedparam(pthread_self(), &policy, &parameters) == 0 &&
        (policy == SCHED_FIFO || policy == SCHED_RR)) {
        tick_set_realtime(servo->tick, 1);
        return;
    }
    memset(&parameters, 0, sizeof parameters);
    parameters.sched_priority = FIFO_PRIORITY;
    tick_set_realtime(servo->tick,
                      pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameters) == 0);
}

/* Whether the library answered what was just asked for; true if the loop must end. */
static bool probed(Servo *servo, unsigned what)
{
    HDErrorInfo error = servo->hd.get_error();
    if (error.errorCode == HD_SUCCESS)
        servo->has |= what;
    if (!ends_the_loop(error.errorCode))
        return false;
    tick_fatal(servo->tick, error.errorCode, error.internalErrorCode);
    return true;
}

/* Reads everything; the first time it also finds out what there is. False: the loop must end. */
static bool read_device(Servo *servo, bool first)
{
    const ServoFunctions *hd = &servo->hd;
    TickSample *s = &servo->sample;
    double values[16] = {0.0};
    HDint buttons = 0;

    hd->get_integerv(HD_CURRENT_BUTTONS, &buttons);
    s->buttons = buttons;
    hd->get_doublev(HD_CURRENT_TRANSFORM, values);
    rotation_to_hand(s->rotation, values);
    hd->get_doublev(HD_CURRENT_POSITION, values);
    to_hand(s->position, values, 1e-3);
    hd->get_doublev(HD_CURRENT_JOINT_ANGLES, s->joints_rad);
    omni_kinematics(s->joints_rad, NULL, s->jacobian);
    /* In every tick: the position jumps with it. */
    s->calibration = (int32_t)hd->check_calibration();
    s->calibrated = s->calibration == HD_CALIBRATION_OK;
    /* Before the step, as what came with a broken link must not go out as a fresh reading; and
     * before asking for what there may not be, as the answer is the newest error. */
    if (take_errors(servo, s->now_s))
        return false;

    if (first || servo->has & HAS_INKWELL) {
        HDboolean docked = 0;
        hd->get_booleanv(HD_CURRENT_INKWELL_SWITCH, &docked);
        s->inkwell = docked != 0;
        if (first && probed(servo, HAS_INKWELL))
            return false;
    }
    if (first || servo->has & HAS_VELOCITY) {
        memset(values, 0, sizeof values);
        hd->get_doublev(HD_CURRENT_VELOCITY, values);
        to_hand(s->velocity, values, 1e-3);
        if (first && probed(servo, HAS_VELOCITY))
            return false;
    }
    if (first || servo->has & HAS_GIMBAL) {
        hd->get_doublev(HD_CURRENT_GIMBAL_ANGLES, s->gimbal_rad);
        if (first && probed(servo, HAS_GIMBAL))
            return false;
    }
    if (first || servo->has & HAS_ENCODERS) {
        HDlong encoders[6] = {0};
        hd->get_longv(HD_CURRENT_ENCODER_VALUES, encoders);
        for (int i = 0; i < 6; i++)
            s->encoders[i] = encoders[i];
        if (first && probed(servo, HAS_ENCODERS))
            return false;
    }
    if (first || (servo->has & HAS_TEMPERATURE && servo->ticks % TEMPERATURE_EVERY == 0)) {
        memset(values, 0, sizeof values); /* 3 or 6 of them */
        hd->get_doublev(HD_MOTOR_TEMPERATURE, values);
        s->temperature = values[0];
        for (int i = 1; i < 6 && !isnan(s->temperature); i++)
            if (!(values[i] <= s->temperature)) /* larger, or no number at all */
                s->temperature = values[i];
        if (first && probed(servo, HAS_TEMPERATURE))
            return false;
    }
    return true;
}

static HDCallbackCode finish(Servo *servo, bool in_frame)
{
    const double nothing[3] = {0.0, 0.0, 0.0};
    if (in_frame) {
        servo->hd.set_doublev(HD_CURRENT_FORCE, nothing);
        servo->hd.end_frame(servo->device);
    }
    tick_set_finished(servo->tick, 1);
    return HD_CALLBACK_DONE;
}

HDCallbackCode servo_callback(void *user)
{
    Servo *servo = user;
    const ServoFunctions *hd = &servo->hd;
    double began_s = monotonic();
    bool first = !servo->started;

    if (first) {
        servo->started = true;
        tick_set_finished(servo->tick, 0);
        if (servo->realtime)
            ask_for_realtime(servo);
    }
    hd->begin_frame(servo->device);
    if (atomic_load(&servo->stop))
        return finish(servo, true);
    servo->sample.now_s = servo->clock();
    if (!read_device(servo, first))
        return finish(servo, true);
    servo->ticks++;

    TickOutput output;
    tick_step(servo->tick, &servo->sample, &output);
    double values[3];
    if (output.torque_mode) {
        for (int i = 0; i < 3; i++)
            values[i] = 1e3 * output.torques_n_m[i];
        hd->set_doublev(HD_CURRENT_JOINT_TORQUE, values);
    } else {
        to_device(values, output.force);
        hd->set_doublev(HD_CURRENT_FORCE, values);
    }
    hd->end_frame(servo->device);
    if (take_errors(servo, servo->sample.now_s))
        return finish(servo, false);
    servo->sample.cost_s = monotonic() - began_s;
    return HD_CALLBACK_CONTINUE;
}
