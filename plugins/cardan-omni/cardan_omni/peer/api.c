/* HDAPI: the device, frames, parameters, errors, calibration. Its units are mm, N, mN·m. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "omni.h"

#define INTERNAL_NO_ANSWER (-28) /* seen from a device whose link was down */

/* The limits as they are at first: what a program may ask is not known of the real library. */
#define VELOCITY_LIMIT_M_S 2.0
#define IMPULSE_LIMIT_N_MS 0.7 /* a fifth of the full force in a tick */
#define RAMPING_N_S 10.0
#define NOMINAL_STIFFNESS_N_MM 0.5
#define NOMINAL_DAMPING_N_S_MM 0.005

/* --- errors ---------------------------------------------------------------------------------- */

void push_error(HDerror code, int internal) {
    Device *device = &omni.device;
    if (device->error_count == ERROR_STACK) { /* the oldest goes */
        memmove(device->errors, device->errors + 1, (ERROR_STACK - 1) * sizeof *device->errors);
        device->error_count--;
    }
    device->errors[device->error_count++] = (HDErrorInfo){
        .errorCode = code,
        .internalErrorCode = internal,
        .hHD = device->initiated ? device->handle : HD_INVALID_HANDLE,
    };
}

HD_API HDErrorInfo hdGetError(void) {
    omni_enter();
    Device *device = &omni.device;
    HDErrorInfo error = {.errorCode = HD_SUCCESS,
                         .hHD = device->initiated ? device->handle : HD_INVALID_HANDLE};
    if (device->error_count) {
        error = device->errors[--device->error_count];
    }
    omni_leave();
    return error;
}

HD_API HDstring hdGetErrorString(HDerror code) {
    static const struct {
        HDerror code;
        HDstring text;
    } TEXTS[] = {
        {HD_SUCCESS, "no error"},
        {HD_INVALID_ENUM, "not a name this function knows"},
        {HD_INVALID_VALUE, "value out of range"},
        {HD_INVALID_OPERATION, "operation not possible now"},
        {HD_INVALID_INPUT_TYPE, "the parameter has another type"},
        {HD_BAD_HANDLE, "no such device handle"},
        {HD_WARM_MOTORS, "the motors are too warm"},
        {HD_EXCEEDED_MAX_FORCE, "the force exceeds the maximum"},
        {HD_EXCEEDED_MAX_FORCE_IMPULSE, "the force changes too fast"},
        {HD_EXCEEDED_MAX_VELOCITY, "the stylus moves too fast"},
        {HD_FORCE_ERROR, "forces that exclude each other, or are not numbers"},
        {HD_DEVICE_FAULT, "the device has failed or is not there"},
        {HD_DEVICE_ALREADY_INITIATED, "the device is initialized already"},
        {HD_COMM_ERROR, "no communication with the device"},
        {HD_COMM_CONFIG_ERROR, "the communication is not configured"},
        {HD_TIMER_ERROR, "the scheduler's timer has failed"},
        {HD_ILLEGAL_BEGIN, "a frame was begun already in this tick"},
        {HD_ILLEGAL_END, "no frame was begun"},
        {HD_FRAME_ERROR, "only possible inside a frame"},
        {HD_INVALID_PRIORITY, "priority out of range"},
        {HD_SCHEDULER_FULL, "the scheduler takes no more callbacks"},
        {HD_INVALID_LICENSE, "there is no valid license"},
    };
    for (size_t i = 0; i < sizeof TEXTS / sizeof *TEXTS; i++) {
        if (TEXTS[i].code == code) {
            return TEXTS[i].text;
        }
    }
    return "not an error code";
}

/* --- the device ------------------------------------------------------------------------------ */

void device_power_on(void) {
    Device *device = &omni.device;
    for (int i = 0; i < CAP_COUNT; i++) {
        device->enabled[i] = i != CAP_FORCE_OUTPUT && i != CAP_USER_STATUS_LIGHT;
    }
    device->velocity_limit_m_s = VELOCITY_LIMIT_M_S;
    device->impulse_limit_n_ms = IMPULSE_LIMIT_N_MS;
    device->ramping_n_s = RAMPING_N_S;
}

int device_take_environment(void) {
    const char *path = getenv("CARDAN_OMNI");
    if (omni.configured || !path || !*path) {
        return 0;
    }
    Settings settings;
    int log_file;
    int bad = settings_parse_file(&settings, path);
    if (!bad && log_open(&settings, &log_file)) {
        free(settings.waypoints);
        bad = -1;
    }
    if (bad) {
        fprintf(stderr, "libHD (simulated): CARDAN_OMNI: %s\n", simProblem());
        return -1;
    }
    int licensed = omni.device.licensed;
    Scheduler scheduler = omni.scheduler; /* what was scheduled before stays */
    omni_power_on(&settings, log_file);
    memcpy(omni.scheduler.entries, scheduler.entries, sizeof scheduler.entries);
    omni.scheduler.last_handle = scheduler.last_handle;
    omni.device.licensed = licensed;
    omni.configured = 1;
    return 0;
}

static int known_name(HDstring name) {
    const char *own = omni.settings.device;
    return !name || strcmp(name, "Default Device") == 0 || strcmp(name, "Default PHANToM") == 0 ||
           (*own && strcmp(name, own) == 0);
}

static HHD initiate(HDstring name) {
    Device *device = &omni.device;
    if (device->initiated) {
        push_error(HD_DEVICE_ALREADY_INITIATED, 0);
        return HD_INVALID_HANDLE;
    }
    if (!omni.scheduler.started && device_take_environment()) {
        push_error(HD_DEVICE_FAULT, 0);
        return HD_INVALID_HANDLE;
    }
    if (omni.fault[FAULT_NO_LICENSE] != 0.0 && !device->licensed) {
        push_error(HD_INVALID_LICENSE, 0);
        return HD_INVALID_HANDLE;
    }
    if (omni.fault[FAULT_INIT_FAILS] != 0.0) {
        HDerror error = (HDerror)omni.fault[FAULT_INIT_FAILS];
        push_error(error, error == HD_COMM_ERROR ? INTERNAL_NO_ANSWER : 0);
        return HD_INVALID_HANDLE;
    }
    if (!known_name(name) || omni.fault[FAULT_UNPLUG] != 0.0) {
        push_error(HD_DEVICE_FAULT, 0);
        return HD_INVALID_HANDLE;
    }
    if (omni.fault[FAULT_COMM_ERROR] != 0.0) {
        push_error(HD_COMM_ERROR, INTERNAL_NO_ANSWER);
        return HD_INVALID_HANDLE;
    }
    Device fresh = {.initiated = 1, .current = 1, .handle = device->next_handle,
                    .next_handle = device->next_handle + 1, .licensed = device->licensed,
                    .error_count = device->error_count};
    memcpy(fresh.errors, device->errors, sizeof fresh.errors);
    *device = fresh;
    device_power_on();
    arm_silence();
    if (!omni.scheduler.started) {
        arm_sample_now();
    }
    device->frame.current = device->frame.last = omni.arm.ready;
    return device->handle;
}

HD_API HHD hdInitDevice(HDstring name) {
    omni_enter();
    HHD handle = initiate(name);
    omni_leave();
    return handle;
}

/* With the lock; 0 and an error when there is no such device. */
static int is_device(HHD handle) {
    if (omni.device.initiated && omni.device.handle == handle) {
        return 1;
    }
    push_error(HD_BAD_HANDLE, 0);
    return 0;
}

HD_API void hdDisableDevice(HHD handle) {
    omni_enter();
    if (is_device(handle)) {
        omni.device.initiated = 0;
        omni.device.current = 0;
        omni.device.gone = 0;
        arm_silence();
    }
    omni_leave();
    log_flush();
}

HD_API void hdMakeCurrentDevice(HHD handle) {
    omni_enter();
    omni.device.current |= is_device(handle);
    omni_leave();
}

/* With the lock; 0 and an error when no device is current. */
static int have_device(void) {
    if (omni.device.current) {
        return 1;
    }
    push_error(HD_INVALID_OPERATION, 0);
    return 0;
}

/* Before the first hdInitDevice there is an error, and the handle that the first device gets, 0:
 * pyOpenHaptics, written against the vendor's library, goes on only if the two are the same. */
HD_API HHD hdGetCurrentDevice(void) {
    omni_enter();
    int known = have_device() || omni.device.next_handle == 0;
    HHD handle = known ? omni.device.handle : HD_INVALID_HANDLE;
    omni_leave();
    return handle;
}

HD_API HDboolean hdDeploymentLicense(const char *vendor, const char *application,
                                     const char *password) {
    omni_enter();
    HDboolean good = HD_FALSE;
    if (omni.device.initiated) {
        push_error(HD_INVALID_OPERATION, 0);
    } else if (!vendor || !application || !password || !*vendor || !*application || !*password) {
        push_error(HD_INVALID_LICENSE, 0);
    } else {
        omni.device.licensed = 1;
        good = HD_TRUE;
    }
    omni_leave();
    return good;
}

/* With the lock; 0 and an error when the device does not. */
static int answers(void) {
    if (arm_connected()) {
        return 1;
    }
    if (omni.device.gone || omni.fault[FAULT_UNPLUG] != 0.0) {
        push_error(HD_DEVICE_FAULT, 0);
    } else {
        push_error(HD_COMM_ERROR, INTERNAL_NO_ANSWER);
    }
    return 0;
}

/* --- frames ---------------------------------------------------------------------------------- */

static void begin(void) {
    Device *device = &omni.device;
    Frame *frame = &device->frame;
    if (frame->depth) {
        frame->depth++;
        return;
    }
    if (frame->used && device->enabled[CAP_ONE_FRAME_LIMIT] && omni.scheduler.started) {
        push_error(HD_ILLEGAL_BEGIN, 0);
        return;
    }
    frame->used = 1;
    frame->depth = 1;
    frame->last = frame->current;
    if (answers()) {
        if (!omni.scheduler.started) {
            arm_sample_now();
        }
        frame->current = omni.arm.ready;
    }
    memset(frame->force_n, 0, sizeof frame->force_n);
    memset(frame->torque_n_m, 0, sizeof frame->torque_n_m);
    memset(frame->joint_torque_n_m, 0, sizeof frame->joint_torque_n_m);
    memset(frame->gimbal_torque_n_m, 0, sizeof frame->gimbal_torque_n_m);
    memset(frame->dac, 0, sizeof frame->dac);
    frame->force_set = frame->joint_torque_set = frame->dac_set = frame->conflict = 0;
}

static const double DAC_N_M = OMNI_FULL_SCALE_N_M / 32767.0;

static void end(void) {
    Frame *frame = &omni.device.frame;
    if (!frame->depth) {
        push_error(HD_ILLEGAL_END, 0);
        return;
    }
    if (--frame->depth) {
        return;
    }
    double force[3], torque[3];
    memcpy(force, frame->force_n, sizeof force);
    memcpy(torque, frame->joint_torque_n_m, sizeof torque);
    int torque_mode = frame->joint_torque_set;
    if (frame->dac_set) {
        torque_mode = 1;
        for (int i = 0; i < 3; i++) {
            torque[i] = (double)frame->dac[i] * DAC_N_M;
        }
    }
    if (frame->conflict) {
        memset(force, 0, sizeof force);
        memset(torque, 0, sizeof torque);
        torque_mode = 0;
    }
    if (arm_connected()) {
        frame->flushed = 1;
        arm_command(force, torque, torque_mode);
    }
    const double *joints = frame->current.joints_rad;
    if (torque_mode) {
        arm_torque_to_force(joints, torque, force);
    } else {
        arm_force_to_torque(joints, force, torque);
    }
    double size = sqrt(force[0] * force[0] + force[1] * force[1] + force[2] * force[2]);
    double kept = 1.0;
    if (!isfinite(size)) {
        kept = 0.0;
    } else if (size > OMNI_MAX_FORCE_N && omni.device.enabled[CAP_MAX_FORCE_CLAMPING]) {
        kept = OMNI_MAX_FORCE_N / size;
    }
    for (int i = 0; i < 3; i++) {
        frame->last_force_n[i] = kept > 0.0 ? kept * force[i] : 0.0;
        frame->last_joint_torque_n_m[i] = kept > 0.0 ? kept * torque[i] : 0.0;
        frame->last_torque_n_m[i] = frame->torque_n_m[i];
        frame->last_gimbal_torque_n_m[i] = frame->gimbal_torque_n_m[i];
        double dac = frame->last_joint_torque_n_m[i] / DAC_N_M;
        frame->last_dac[i] = lround(fmax(-32767.0, fmin(32766.0, dac)));
    }
}

void device_end_of_tick(void) {
    Frame *frame = &omni.device.frame;
    if (frame->depth) {
        frame->depth = 0;
        push_error(HD_FRAME_ERROR, 0);
    }
    if (!frame->flushed) {
        arm_silence();
    }
}

HD_API void hdBeginFrame(HHD handle) {
    omni_enter();
    if (is_device(handle)) {
        omni.device.current = 1;
        begin();
    }
    omni_leave();
}

HD_API void hdEndFrame(HHD handle) {
    omni_enter();
    if (is_device(handle)) {
        omni.device.current = 1;
        end();
    }
    omni_leave();
}

/* --- parameters ------------------------------------------------------------------------------ */

enum { BOOL = 1, INT = 2, LONG = 4, FLOAT = 8, DOUBLE = 16, STRING = 32, REAL = FLOAT | DOUBLE };

typedef struct {
    HDenum name;
    unsigned types; /* that read it */
    int count;
    int settable;
} Parameter;

static const Parameter PARAMETERS[] = {
    {HD_CURRENT_BUTTONS, INT, 1, 0},
    {HD_CURRENT_SAFETY_SWITCH, BOOL, 1, 0},
    {HD_CURRENT_INKWELL_SWITCH, BOOL, 1, 0},
    {HD_CURRENT_ENCODER_VALUES, LONG, 6, 0},
    {HD_CURRENT_POSITION, REAL, 3, 0},
    {HD_CURRENT_VELOCITY, REAL, 3, 0},
    {HD_CURRENT_TRANSFORM, REAL, 16, 0},
    {HD_CURRENT_ANGULAR_VELOCITY, REAL, 3, 0},
    {HD_CURRENT_JOINT_ANGLES, REAL, 3, 0},
    {HD_CURRENT_GIMBAL_ANGLES, REAL, 3, 0},
    {HD_LAST_BUTTONS, INT, 1, 0},
    {HD_LAST_SAFETY_SWITCH, BOOL, 1, 0},
    {HD_LAST_INKWELL_SWITCH, BOOL, 1, 0},
    {HD_LAST_ENCODER_VALUES, LONG, 6, 0},
    {HD_LAST_POSITION, REAL, 3, 0},
    {HD_LAST_VELOCITY, REAL, 3, 0},
    {HD_LAST_TRANSFORM, REAL, 16, 0},
    {HD_LAST_ANGULAR_VELOCITY, REAL, 3, 0},
    {HD_LAST_JOINT_ANGLES, REAL, 3, 0},
    {HD_LAST_GIMBAL_ANGLES, REAL, 3, 0},
    {HD_CURRENT_FORCE, REAL, 3, 1},
    {HD_CURRENT_TORQUE, REAL, 3, 1},
    {HD_CURRENT_JOINT_TORQUE, REAL, 3, 1},
    {HD_CURRENT_GIMBAL_TORQUE, REAL, 3, 1},
    {HD_CURRENT_MOTOR_DAC_VALUES, LONG, 3, 1},
    {HD_LAST_FORCE, REAL, 3, 0},
    {HD_LAST_TORQUE, REAL, 3, 0},
    {HD_LAST_JOINT_TORQUE, REAL, 3, 0},
    {HD_LAST_GIMBAL_TORQUE, REAL, 3, 0},
    {HD_LAST_MOTOR_DAC_VALUES, LONG, 3, 0},
    {HD_USER_STATUS_LIGHT, INT, 1, 1},
    {HD_VERSION, STRING, 1, 0},
    {HD_DEVICE_MODEL_TYPE, STRING, 1, 0},
    {HD_DEVICE_DRIVER_VERSION, STRING, 1, 0},
    {HD_DEVICE_VENDOR, STRING, 1, 0},
    {HD_DEVICE_SERIAL_NUMBER, STRING, 1, 0},
    {HD_DEVICE_FIRMWARE_VERSION, DOUBLE, 1, 0},
    {HD_MAX_WORKSPACE_DIMENSIONS, DOUBLE, 6, 0},
    {HD_USABLE_WORKSPACE_DIMENSIONS, DOUBLE, 6, 0},
    {HD_TABLETOP_OFFSET, FLOAT, 1, 0},
    {HD_INPUT_DOF, INT, 1, 0},
    {HD_OUTPUT_DOF, INT, 1, 0},
    {HD_CALIBRATION_STYLE, INT, 1, 0},
    {HD_UPDATE_RATE, INT, 1, 0},
    {HD_INSTANTANEOUS_UPDATE_RATE, INT, 1, 0},
    {HD_NOMINAL_MAX_STIFFNESS, DOUBLE, 1, 0},
    {HD_NOMINAL_MAX_FORCE, DOUBLE, 1, 0},
    {HD_NOMINAL_MAX_CONTINUOUS_FORCE, DOUBLE, 1, 0},
    {HD_MOTOR_TEMPERATURE, DOUBLE, 3, 0},
    {HD_SOFTWARE_VELOCITY_LIMIT, DOUBLE, 1, 1},
    {HD_SOFTWARE_FORCE_IMPULSE_LIMIT, DOUBLE, 1, 1},
    {HD_FORCE_RAMPING_RATE, DOUBLE, 1, 1},
    {HD_NOMINAL_MAX_DAMPING, DOUBLE, 1, 0},
    {HD_NOMINAL_MAX_TORQUE_STIFFNESS, DOUBLE, 1, 0},
    {HD_NOMINAL_MAX_TORQUE_DAMPING, DOUBLE, 1, 0},
    {HD_NOMINAL_MAX_TORQUE_FORCE, DOUBLE, 1, 0},
    {HD_NOMINAL_MAX_TORQUE_CONTINUOUS_FORCE, DOUBLE, 1, 0},
};

/* With the lock. NULL and an error for a name there is not, a type it has not, or no device. */
static const Parameter *parameter_of(HDenum name, unsigned type, int setting, const void *values) {
    const Parameter *found = NULL;
    for (size_t i = 0; i < sizeof PARAMETERS / sizeof *PARAMETERS; i++) {
        if (PARAMETERS[i].name == name) {
            found = &PARAMETERS[i];
        }
    }
    if (!found || (setting && !found->settable)) {
        push_error(HD_INVALID_ENUM, 0);
        return NULL;
    }
    if (!(found->types & type)) {
        push_error(HD_INVALID_INPUT_TYPE, 0);
        return NULL;
    }
    if (name != HD_VERSION && !have_device()) {
        return NULL;
    }
    if (!values) {
        push_error(HD_INVALID_VALUE, 0);
        return NULL;
    }
    return found;
}

static void copy(double out[], const double from[], int count, double by) {
    for (int i = 0; i < count; i++) {
        out[i] = from[i] * by;
    }
}

static void sample_values(HDenum name, const Sample *sample, double out[16]) {
    switch (name) {
    case HD_CURRENT_BUTTONS:
    case HD_LAST_BUTTONS:
        out[0] = sample->buttons;
        break;
    case HD_CURRENT_INKWELL_SWITCH:
    case HD_LAST_INKWELL_SWITCH:
        out[0] = sample->docked;
        break;
    case HD_CURRENT_ENCODER_VALUES:
    case HD_LAST_ENCODER_VALUES:
        for (int i = 0; i < 6; i++) {
            out[i] = (double)sample->encoders[i];
        }
        break;
    case HD_CURRENT_POSITION:
    case HD_LAST_POSITION:
        copy(out, sample->position_m, 3, 1e3);
        break;
    case HD_CURRENT_VELOCITY:
    case HD_LAST_VELOCITY:
        copy(out, sample->velocity_m_s, 3, 1e3);
        break;
    case HD_CURRENT_TRANSFORM:
    case HD_LAST_TRANSFORM:
        for (int column = 0; column < 3; column++) {
            for (int row = 0; row < 3; row++) {
                out[4 * column + row] = sample->rotation[row][column];
            }
            out[12 + column] = 1e3 * sample->position_m[column];
        }
        out[15] = 1.0;
        break;
    case HD_CURRENT_ANGULAR_VELOCITY:
    case HD_LAST_ANGULAR_VELOCITY:
        copy(out, sample->gimbal_rad_s, 3, 1.0);
        break;
    case HD_CURRENT_JOINT_ANGLES:
    case HD_LAST_JOINT_ANGLES:
        copy(out, sample->joints_rad, 3, 1.0);
        break;
    case HD_CURRENT_GIMBAL_ANGLES:
    case HD_LAST_GIMBAL_ANGLES:
        copy(out, sample->gimbal_rad, 3, 1.0);
        break;
    default: /* safety switches: an Omni has none */
        break;
    }
}

static void long_values(const long from[3], double out[3]) {
    for (int i = 0; i < 3; i++) {
        out[i] = (double)from[i];
    }
}

static void values_of(HDenum name, double out[16]) {
    static const double MAX_MM[6] = {-210, -110, -85, 210, 205, 130};
    static const double USABLE_MM[6] = {-80, -60, -35, 80, 60, 35};
    const Device *device = &omni.device;
    const Frame *frame = &device->frame;
    memset(out, 0, 16 * sizeof *out);
    switch (name) {
    case HD_CURRENT_FORCE: copy(out, frame->force_n, 3, 1.0); break;
    case HD_CURRENT_TORQUE: copy(out, frame->torque_n_m, 3, 1e3); break;
    case HD_CURRENT_JOINT_TORQUE: copy(out, frame->joint_torque_n_m, 3, 1e3); break;
    case HD_CURRENT_GIMBAL_TORQUE: copy(out, frame->gimbal_torque_n_m, 3, 1e3); break;
    case HD_CURRENT_MOTOR_DAC_VALUES: long_values(frame->dac, out); break;
    case HD_LAST_FORCE: copy(out, frame->last_force_n, 3, 1.0); break;
    case HD_LAST_TORQUE: copy(out, frame->last_torque_n_m, 3, 1e3); break;
    case HD_LAST_JOINT_TORQUE: copy(out, frame->last_joint_torque_n_m, 3, 1e3); break;
    case HD_LAST_GIMBAL_TORQUE: copy(out, frame->last_gimbal_torque_n_m, 3, 1e3); break;
    case HD_LAST_MOTOR_DAC_VALUES: long_values(frame->last_dac, out); break;
    case HD_USER_STATUS_LIGHT: out[0] = device->status_light; break;
    case HD_DEVICE_FIRMWARE_VERSION: out[0] = 192.0; break;
    case HD_MAX_WORKSPACE_DIMENSIONS: copy(out, MAX_MM, 6, 1.0); break;
    case HD_USABLE_WORKSPACE_DIMENSIONS: copy(out, USABLE_MM, 6, 1.0); break;
    case HD_TABLETOP_OFFSET: out[0] = 110.0; break;
    case HD_INPUT_DOF: out[0] = 6; break;
    case HD_OUTPUT_DOF: out[0] = 3; break;
    case HD_CALIBRATION_STYLE: out[0] = HD_CALIBRATION_INKWELL; break;
    case HD_UPDATE_RATE: out[0] = round(omni.scheduler.mean_rate_hz); break;
    case HD_INSTANTANEOUS_UPDATE_RATE: out[0] = round(1.0 / omni.scheduler.period_s); break;
    case HD_NOMINAL_MAX_STIFFNESS: out[0] = NOMINAL_STIFFNESS_N_MM; break;
    case HD_NOMINAL_MAX_FORCE: out[0] = OMNI_MAX_FORCE_N; break;
    case HD_NOMINAL_MAX_CONTINUOUS_FORCE: out[0] = OMNI_CONTINUOUS_FORCE_N; break;
    case HD_MOTOR_TEMPERATURE:
        for (int i = 0; i < 3; i++) {
            out[i] = fmin(omni.arm.shown_temperature[i], 1.0);
        }
        break;
    case HD_SOFTWARE_VELOCITY_LIMIT: out[0] = 1e3 * device->velocity_limit_m_s; break;
    case HD_SOFTWARE_FORCE_IMPULSE_LIMIT: out[0] = device->impulse_limit_n_ms; break;
    case HD_FORCE_RAMPING_RATE: out[0] = device->ramping_n_s; break;
    case HD_NOMINAL_MAX_DAMPING: out[0] = NOMINAL_DAMPING_N_S_MM; break;
    case HD_NOMINAL_MAX_TORQUE_STIFFNESS: /* three motors: no torque at the tip */
    case HD_NOMINAL_MAX_TORQUE_DAMPING:
    case HD_NOMINAL_MAX_TORQUE_FORCE:
    case HD_NOMINAL_MAX_TORQUE_CONTINUOUS_FORCE: break;
    default:
        sample_values(name, name >= HD_LAST_BUTTONS && name <= HD_LAST_GIMBAL_ANGLES
                                ? &frame->last
                                : &frame->current,
                      out);
    }
}

#define GETTER(function, type, tag)                                                               \
    HD_API void function(HDenum name, type *values) {                                             \
        double read[16];                                                                          \
        omni_enter();                                                                             \
        const Parameter *parameter = parameter_of(name, tag, 0, values);                          \
        if (parameter) {                                                                          \
            values_of(name, read);                                                                \
            for (int i = 0; i < parameter->count; i++) {                                          \
                values[i] = (type)read[i];                                                        \
            }                                                                                     \
        }                                                                                         \
        omni_leave();                                                                             \
    }

GETTER(hdGetBooleanv, HDboolean, BOOL)
GETTER(hdGetIntegerv, HDint, INT)
GETTER(hdGetFloatv, HDfloat, FLOAT)
GETTER(hdGetDoublev, HDdouble, DOUBLE)
GETTER(hdGetLongv, HDlong, LONG)

HD_API HDstring hdGetString(HDenum name) {
    HDstring text = NULL;
    omni_enter();
    if (parameter_of(name, STRING, 0, "")) {
        switch (name) {
        case HD_VERSION: text = "3.4.0"; break;
        case HD_DEVICE_MODEL_TYPE: text = omni.settings.model; break;
        case HD_DEVICE_DRIVER_VERSION: text = "4.3.2 (simulated)"; break;
        case HD_DEVICE_VENDOR: text = "simulated"; break;
        default: text = omni.settings.serial; break;
        }
    }
    omni_leave();
    return text;
}

/* Force, torque, joint torque, gimbal torque: where in the frame, or NULL. */
static double *output_of(HDenum name) {
    Frame *frame = &omni.device.frame;
    switch (name) {
    case HD_CURRENT_FORCE: return frame->force_n;
    case HD_CURRENT_TORQUE: return frame->torque_n_m;
    case HD_CURRENT_JOINT_TORQUE: return frame->joint_torque_n_m;
    case HD_CURRENT_GIMBAL_TORQUE: return frame->gimbal_torque_n_m;
    default: return NULL;
    }
}

static void set_output(HDenum name, const double values[3]) {
    Frame *frame = &omni.device.frame;
    if (!frame->depth) {
        push_error(HD_FRAME_ERROR, 0);
        return;
    }
    if (name == HD_CURRENT_MOTOR_DAC_VALUES) {
        for (int i = 0; i < 3; i++) {
            if (values[i] < -32767.0 || values[i] > 32766.0) {
                push_error(HD_INVALID_VALUE, 0);
                return;
            }
        }
        for (int i = 0; i < 3; i++) {
            frame->dac[i] = (long)values[i];
        }
        frame->dac_set = 1;
    } else {
        copy(output_of(name), values, 3, name == HD_CURRENT_FORCE ? 1.0 : 1e-3);
        frame->force_set |= name == HD_CURRENT_FORCE || name == HD_CURRENT_TORQUE;
        frame->joint_torque_set |= name == HD_CURRENT_JOINT_TORQUE;
    }
    if (frame->dac_set && frame->force_set && !frame->conflict) {
        frame->conflict = 1;
        push_error(HD_FORCE_ERROR, 0);
    }
}

static void set_value(HDenum name, const double values[]) {
    Device *device = &omni.device;
    double value = values[0];
    switch (name) {
    case HD_USER_STATUS_LIGHT:
    case HD_SOFTWARE_VELOCITY_LIMIT:
    case HD_SOFTWARE_FORCE_IMPULSE_LIMIT:
    case HD_FORCE_RAMPING_RATE:
        if (!isfinite(value) || value < 0.0 || (name == HD_USER_STATUS_LIGHT && value > 7.0)) {
            push_error(HD_INVALID_VALUE, 0);
            return;
        }
        break;
    default:
        set_output(name, values);
        return;
    }
    if (name == HD_USER_STATUS_LIGHT) {
        device->status_light = (int)value;
    } else if (name == HD_SOFTWARE_VELOCITY_LIMIT) {
        device->velocity_limit_m_s = 1e-3 * value;
    } else if (name == HD_SOFTWARE_FORCE_IMPULSE_LIMIT) {
        device->impulse_limit_n_ms = value;
    } else {
        device->ramping_n_s = value;
    }
}

#define SETTER(function, type, tag)                                                               \
    HD_API void function(HDenum name, const type *values) {                                       \
        double given[16];                                                                         \
        omni_enter();                                                                             \
        const Parameter *parameter = parameter_of(name, tag, 1, values);                          \
        if (parameter) {                                                                          \
            for (int i = 0; i < parameter->count; i++) {                                          \
                given[i] = (double)values[i];                                                     \
            }                                                                                     \
            set_value(name, given);                                                               \
        }                                                                                         \
        omni_leave();                                                                             \
    }

SETTER(hdSetBooleanv, HDboolean, BOOL)
SETTER(hdSetIntegerv, HDint, INT)
SETTER(hdSetFloatv, HDfloat, FLOAT)
SETTER(hdSetDoublev, HDdouble, DOUBLE)
SETTER(hdSetLongv, HDlong, LONG)

/* --- capabilities ---------------------------------------------------------------------------- */

/* With the lock: a place in `enabled`, or -1 and an error. */
static int capability_of(HDenum name) {
    static const HDenum NAMES[CAP_COUNT] = {
        [CAP_FORCE_OUTPUT] = HD_FORCE_OUTPUT,
        [CAP_MAX_FORCE_CLAMPING] = HD_MAX_FORCE_CLAMPING,
        [CAP_FORCE_RAMPING] = HD_FORCE_RAMPING,
        [CAP_SOFTWARE_FORCE_LIMIT] = HD_SOFTWARE_FORCE_LIMIT,
        [CAP_ONE_FRAME_LIMIT] = HD_ONE_FRAME_LIMIT,
        [CAP_SOFTWARE_VELOCITY_LIMIT] = HD_SOFTWARE_VELOCITY_LIMIT,
        [CAP_SOFTWARE_FORCE_IMPULSE_LIMIT] = HD_SOFTWARE_FORCE_IMPULSE_LIMIT,
        [CAP_USER_STATUS_LIGHT] = HD_USER_STATUS_LIGHT,
    };
    for (int i = 0; i < CAP_COUNT; i++) {
        if (NAMES[i] == name) {
            return have_device() ? i : -1;
        }
    }
    push_error(HD_INVALID_ENUM, 0);
    return -1;
}

static void enable(HDenum name, int on) {
    omni_enter();
    int capability = capability_of(name);
    if (capability >= 0) {
        omni.device.enabled[capability] = on;
    }
    omni_leave();
}

HD_API void hdEnable(HDenum name) { enable(name, 1); }
HD_API void hdDisable(HDenum name) { enable(name, 0); }

HD_API HDboolean hdIsEnabled(HDenum name) {
    omni_enter();
    int capability = capability_of(name);
    HDboolean on = capability >= 0 && omni.device.enabled[capability];
    omni_leave();
    return on;
}

/* --- calibration ----------------------------------------------------------------------------- */

HD_API HDenum hdCheckCalibration(void) {
    HDenum state = HD_CALIBRATION_NEEDS_MANUAL_INPUT;
    omni_enter();
    if (have_device() && answers()) {
        if (omni.arm.calibrated) {
            state = HD_CALIBRATION_OK;
        } else if (omni.arm.locked) {
            state = HD_CALIBRATION_NEEDS_UPDATE;
        }
    }
    omni_leave();
    return state;
}

HD_API void hdUpdateCalibration(HDenum style) {
    omni_enter();
    Arm *arm = &omni.arm;
    if (style != HD_CALIBRATION_ENCODER_RESET && style != HD_CALIBRATION_AUTO &&
        style != HD_CALIBRATION_INKWELL) {
        push_error(HD_INVALID_ENUM, 0);
    } else if (have_device()) {
        if (answers()) {
            /* The encoders are read by the scheduler: without it there is nothing to set. */
            if (style == HD_CALIBRATION_INKWELL && arm->locked && omni.scheduler.started) {
                arm_calibrate();
            } else {
                push_error(HD_INVALID_OPERATION, 0);
            }
        }
    }
    omni_leave();
}

HD_API HDenum hdCheckCalibrationStyle(void) {
    omni_enter();
    HDenum style = have_device() ? HD_CALIBRATION_INKWELL : 0;
    omni_leave();
    return style;
}

/* A program tells the device that it asks its user to calibrate; an Omni shows nothing. */
HD_API void hdUpdateCalibrationMessage(HDenum style) {
    omni_enter();
    if (style != HD_CALIBRATION_ENCODER_RESET && style != HD_CALIBRATION_AUTO &&
        style != HD_CALIBRATION_INKWELL) {
        push_error(HD_INVALID_ENUM, 0);
    } else {
        (void)have_device();
    }
    omni_leave();
}

/* Undocumented by its vendor; here the transform with each gimbal angle so much larger. */
HD_API void hdScaleGimbalAngles(HDdouble first, HDdouble second, HDdouble third,
                                HDdouble transform[16]) {
    omni_enter();
    if (!transform) {
        push_error(HD_INVALID_VALUE, 0);
    } else if (have_device()) {
        Sample scaled = omni.device.frame.current;
        const double by[3] = {first, second, third};
        double gimbal[3];
        for (int i = 0; i < 3; i++) {
            gimbal[i] = by[i] * arm_gimbal_of(scaled.encoders[3 + i]);
        }
        double values[16] = {0.0};
        arm_rotation(scaled.joints_rad, gimbal, scaled.rotation);
        sample_values(HD_CURRENT_TRANSFORM, &scaled, values);
        memcpy(transform, values, sizeof values);
    }
    omni_leave();
}
