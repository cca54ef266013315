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

/* Optional values of a device: asked for once, and not again if that gave an error. */
enum { HAS_VELOCITY = 1, HAS_GIMBAL = 2, HAS_ENCODERS = 4, HAS_TEMPERATURE = 8, HAS_INKWELL = 16 };

/* The library has one stack of errors for all devices, and a servo that empties it finds the others'
 * too: each gets its own by this letter box. The boxes are static, since a servo may be freed while
 * another one's tick looks for it. */
#define BOXES 16

typedef struct {
    _Atomic uint64_t owner; /* handle + 1; 0: free */
    _Atomic uint64_t error; /* code << 32 | internal; 0: none. One that ends the loop stays */
} Box;

static Box boxes[BOXES];

struct Servo {
    Tick *tick;
    Box *box; /* NULL: there were too many */
    ServoFunctions hd;
    HHD device;
    double (*clock)(void);
    bool realtime;
    _Atomic int stop;
    bool started;
    bool probed; /* what there is was asked for */
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
    for (int i = 0; i < BOXES && !servo->box; i++) {
        uint64_t unowned = 0;
        if (atomic_compare_exchange_strong(&boxes[i].owner, &unowned, (uint64_t)device + 1)) {
            servo->box = boxes + i;
            atomic_store(&servo->box->error, 0);
        }
    }
    return servo;
}

void servo_destroy(Servo *servo)
{
    if (servo->box)
        atomic_store(&servo->box->owner, 0);
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

static bool is_force_error(HDerror code)
{
    return (code & 0xff00u) == 0x0200u;
}

/* An error of another device: to whom it may concern. */
static void forward(const HDErrorInfo *error)
{
    uint64_t packed = (uint64_t)error->errorCode << 32 | (uint32_t)error->internalErrorCode;
    for (int i = 0; i < BOXES; i++) {
        if (atomic_load(&boxes[i].owner) != (uint64_t)error->hHD + 1)
            continue;
        uint64_t before = atomic_load(&boxes[i].error);
        while (!ends_the_loop((HDerror)(before >> 32)) &&
               !atomic_compare_exchange_weak(&boxes[i].error, &before, packed))
            ;
    }
}

/* True if it ends the loop. */
static bool take(Servo *servo, HDerror code, int internal, double now_s)
{
    if (ends_the_loop(code)) {
        tick_fatal(servo->tick, code, internal);
        return true;
    }
    tick_error(servo->tick, code, internal, now_s);
    return false;
}

/* Take this device's error found by another servo; true if it ends the loop. */
static bool take_letter(Servo *servo, double now_s)
{
    uint64_t letter = servo->box ? atomic_exchange(&servo->box->error, 0) : 0;
    return letter && take(servo, (HDerror)(letter >> 32), (int32_t)(uint32_t)letter, now_s);
}

/* Empties the library's stack of errors; true if one of them ends the loop. `failed`, where it is
 * not NULL, becomes true if one says that a reading failed. */
static bool take_errors(Servo *servo, double now_s, bool *failed)
{
    for (int i = 0; i < ERRORS_AT_ONCE; i++) {
        HDErrorInfo error = servo->hd.get_error();
        if (error.errorCode == HD_SUCCESS)
            return false;
        if (error.hHD != servo->device && error.hHD != HD_INVALID_HANDLE) {
            forward(&error);
            continue;
        }
        if (take(servo, error.errorCode, error.internalErrorCode, now_s))
            return true;
        if (failed && !is_force_error(error.errorCode))
            *failed = true;
    }
    return false;
}

static void ask_for_realtime(Servo *servo)
{
    int policy;
    struct sched_param parameters;
    bool held = pthread_getschedparam(pthread_self(), &policy, &parameters) == 0 &&
                (policy == SCHED_FIFO || policy == SCHED_RR);
    if (!held || parameters.sched_priority < FIFO_PRIORITY) { /* or inherited of the robot's loop */
        memset(&parameters, 0, sizeof parameters);
        parameters.sched_priority = FIFO_PRIORITY;
        held = pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameters) == 0 || held;
    }
    tick_set_realtime(servo->tick, held);
}

/* Whether the library answered what was just asked for; true if the loop must end. */
static bool probed(Servo *servo, unsigned what)
{
    HDErrorInfo error = servo->hd.get_error();
    if (error.errorCode == HD_SUCCESS)
        servo->has |= what;
    if (error.errorCode != HD_SUCCESS && error.hHD != servo->device &&
        error.hHD != HD_INVALID_HANDLE) {
        forward(&error);
        servo->has |= what;
        return false;
    }
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
    double transform[16] = {0.0}, position[3] = {0.0}, joints[16] = {0.0}, values[16];
    HDint buttons = 0;

    /* Errors now on the stack are of another thread, or of the tick before. */
    if (take_letter(servo, s->now_s) || take_errors(servo, s->now_s, NULL))
        return false;
    hd->get_integerv(HD_CURRENT_BUTTONS, &buttons);
    hd->get_doublev(HD_CURRENT_TRANSFORM, transform);
    hd->get_doublev(HD_CURRENT_POSITION, position);
    hd->get_doublev(HD_CURRENT_JOINT_ANGLES, joints);
    /* In every tick: the position jumps with it. */
    HDenum calibration = hd->check_calibration();
    /* Before the step, as what came with a broken link must not go out as a fresh reading; and
     * before asking for what there may not be, as the answer is the newest error. */
    bool failed = false;
    if (take_errors(servo, s->now_s, &failed))
        return false;
    /* No number at all is not the library's way to say so: the tick judges those. */
    bool numbers = true;
    for (int i = 0; i < 12; i++)
        numbers = numbers && isfinite(transform[i + i / 3]);
    if (!numbers)
        s->rotation[0] = NAN;
    s->unsound = failed || (!rotation_to_hand(s->rotation, transform) && numbers);
    if (s->unsound)
        return true; /* nothing of it counts, and the rest is not asked for */
    s->buttons = buttons;
    to_hand(s->position, position, 1e-3);
    memcpy(s->joints_rad, joints, sizeof s->joints_rad);
    omni_kinematics(s->joints_rad, NULL, s->jacobian);
    s->calibration = (int32_t)calibration;
    s->calibrated = calibration == HD_CALIBRATION_OK;

    if (first || servo->has & HAS_INKWELL) {
        HDboolean docked = s->inkwell != 0;
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
    bool first = !servo->probed;

    if (!servo->started) {
        servo->started = true;
        tick_begin(servo->tick);
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
    servo->probed = servo->probed || !servo->sample.unsound;

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
    if (take_errors(servo, servo->sample.now_s, NULL))
        return finish(servo, false);
    servo->sample.cost_s = monotonic() - began_s;
    return HD_CALLBACK_CONTINUE;
}
