/* The arm of a Phantom Omni: kinematics, dynamics with the hand, sensors, motors and their limits.
 *
 * The stylus is a point mass in Cartesian space with Coulomb and viscous friction, joined to the
 * hand's mass while it is gripped. A sub-step is the implicit midpoint rule: unconditionally
 * stable, and each force's work over a sub-step is exactly force times displacement, so that the
 * energies add up. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "omni.h"

#define L1 0.13335
#define L2 0.13335
#define L3 0.02335
#define L4 0.16835
#define PI 3.14159265358979323846

#define SUB_STEP_S 62.5e-6
#define FRICTION_SPEED_M_S 0.002 /* where Coulomb friction is nearly whole */
#define COUNT_RAD (2.0 * PI / 15000.0)
#define GIMBAL_COUNT_RAD (0.0735 * PI / 180.0)
#define CONVERTER_STEPS 2047.0   /* 12 bits about a center */
#define REACH_M 0.262            /* of the gimbal center from the shoulder */
#define DOCK_WITHIN_M 0.002
#define TURN_LAG_S 0.02
#define FILTER_HZ 40.0           /* two stages: the library's velocity */
#define OFF_S 0.1                /* the amplifier after an EXCEEDED error */
#define UNFED_S 0.025            /* the amplifier drops a force that is not renewed */
#define COOL 0.8
#define TELL_AGAIN_S 1.0

static const double INKWELL_M[3] = {0.0, -0.0655107, -0.0881142};
static const double STOP_LOW_M[3] = {-0.21, -0.11, -0.0881142};
static const double STOP_HIGH_M[3] = {0.21, 0.205, 0.13};
/* Torques that 0.88 N at the center of the workspace needs, sideways, upward and forward. */
static const double CONTINUOUS_N_M[3] = {0.148148, 0.086410, 0.099899};

/* --- kinematics ------------------------------------------------------------------------------ */

void arm_forward(const double q[3], double p[3]) {
    double r = L1 * cos(q[1]) + L2 * sin(q[2]);
    p[0] = -r * sin(q[0]);
    p[1] = L1 * sin(q[1]) - L2 * cos(q[2]) + L3;
    p[2] = r * cos(q[0]) - L4;
}

void arm_inverse(const double p[3], double q[3]) {
    double r = hypot(p[0], p[2] + L4);
    double h = p[1] - L3;
    double c = (r * r + h * h - L1 * L1 - L2 * L2) / (2.0 * L1 * L2);
    double bend = -acos(fmax(-1.0, fmin(1.0, c)));
    q[0] = atan2(-p[0], p[2] + L4);
    q[1] = atan2(h, r) - atan2(L2 * sin(bend), L1 + L2 * cos(bend));
    q[2] = q[1] + bend + PI / 2.0;
}

void arm_jacobian(const double q[3], double j[3][3]) {
    double s1 = sin(q[0]), c1 = cos(q[0]);
    double s2 = sin(q[1]), c2 = cos(q[1]);
    double s3 = sin(q[2]), c3 = cos(q[2]);
    double r = L1 * c2 + L2 * s3;
    const double rows[3][3] = {
        {-c1 * r, s1 * L1 * s2, -s1 * L2 * c3},
        {0.0, L1 * c2, L2 * s3},
        {-s1 * r, -c1 * L1 * s2, c1 * L2 * c3},
    };
    memcpy(j, rows, sizeof rows);
}

void arm_force_to_torque(const double q[3], const double force[3], double torque[3]) {
    double j[3][3];
    arm_jacobian(q, j);
    for (int i = 0; i < 3; i++) {
        torque[i] = j[0][i] * force[0] + j[1][i] * force[1] + j[2][i] * force[2];
    }
}

void arm_torque_to_force(const double q[3], const double torque[3], double force[3]) {
    double j[3][3];
    arm_jacobian(q, j);
    /* Rows of the transpose, crossed: Cramer's rule. */
    double cross[3][3];
    for (int i = 0; i < 3; i++) {
        int a = (i + 1) % 3, b = (i + 2) % 3;
        cross[i][0] = j[1][a] * j[2][b] - j[2][a] * j[1][b];
        cross[i][1] = j[2][a] * j[0][b] - j[0][a] * j[2][b];
        cross[i][2] = j[0][a] * j[1][b] - j[1][a] * j[0][b];
    }
    double determinant =
        j[0][0] * cross[0][0] + j[1][0] * cross[0][1] + j[2][0] * cross[0][2];
    for (int i = 0; i < 3; i++) {
        force[i] = fabs(determinant) < 1e-9
                       ? 0.0
                       : (torque[0] * cross[0][i] + torque[1] * cross[1][i] +
                          torque[2] * cross[2][i]) /
                             determinant;
    }
}

static void multiply(double out[3][3], const double a[3][3], const double b[3][3]) {
    double product[3][3];
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            product[i][k] = a[i][0] * b[0][k] + a[i][1] * b[1][k] + a[i][2] * b[2][k];
        }
    }
    memcpy(out, product, sizeof product);
}

static void about(int axis, double angle, double out[3][3]) {
    int a = (axis + 1) % 3, b = (axis + 2) % 3;
    double s = sin(angle), c = cos(angle);
    memset(out, 0, 9 * sizeof(double));
    out[axis][axis] = 1.0;
    out[a][a] = c;
    out[b][b] = c;
    out[a][b] = -s;
    out[b][a] = s;
}

static void forearm(const double q[3], double out[3][3]) {
    double turn[3][3];
    about(1, q[0], out);
    about(0, -q[2], turn);
    multiply(out, out, turn);
}

void arm_rotation(const double q[3], const double gimbal[3], double rotation[3][3]) {
    static const int AXES[3] = {2, 0, 2};
    double turn[3][3];
    forearm(q, rotation);
    for (int i = 0; i < 3; i++) {
        about(AXES[i], gimbal[i], turn);
        multiply(rotation, rotation, turn);
    }
}

static double wrapped(double angle) { return remainder(angle, 2.0 * PI); }

/* The gimbal that points the stylus so: of the two solutions the one nearer to `gimbal`. */
static void point_gimbal(const double q[3], const double rotation[3][3], double gimbal[3]) {
    double arm[3][3], back[3][3], rest[3][3];
    forearm(q, arm);
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            back[i][k] = arm[k][i];
        }
    }
    multiply(rest, back, rotation);
    double bend = hypot(rest[0][2], rest[1][2]);
    if (bend < 1e-7) { /* the outer axes are one: all the turn is the inner one's */
        double first[3][3];
        about(2, -gimbal[0], first);
        multiply(rest, first, rest);
        gimbal[1] = rest[2][2] > 0.0 ? 0.0 : PI;
        gimbal[2] = atan2(-rest[0][1], rest[0][0]);
        return;
    }
    double first = atan2(rest[0][2], -rest[1][2]);
    double second = atan2(bend, rest[2][2]);
    double third = atan2(rest[2][0], rest[2][1]);
    if (fabs(wrapped(first - gimbal[0])) > PI / 2.0) {
        first = wrapped(first + PI);
        second = -second;
        third = wrapped(third + PI);
    }
    gimbal[0] = first;
    gimbal[1] = second;
    gimbal[2] = third;
}

/* --- motors ---------------------------------------------------------------------------------- */

static double norm(const double v[3]) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

static void scale(double v[3], double by) {
    for (int i = 0; i < 3; i++) {
        v[i] *= by;
    }
}

int arm_connected(void) {
    return omni.fault[FAULT_COMM_ERROR] == 0.0 && omni.fault[FAULT_UNPLUG] == 0.0 &&
           !omni.device.gone;
}

static void silence_motors(void) {
    Arm *arm = &omni.arm;
    memset(arm->output_n, 0, sizeof arm->output_n);
    memset(arm->output_n_m, 0, sizeof arm->output_n_m);
    memset(arm->delivered_n, 0, sizeof arm->delivered_n);
    arm->torque_mode = 0;
}

static void set_amplifier(void) {
    Arm *arm = &omni.arm;
    const Device *device = &omni.device;
    int on = device->initiated && device->enabled[CAP_FORCE_OUTPUT] && omni.scheduler.started &&
             arm_connected() && !arm->locked && !arm->warm && omni.elapsed_s >= arm->off_until_s;
    if (on && !arm->amplifier) {
        arm->ramp_n = 0.0;
    }
    if (!on) {
        silence_motors();
    }
    arm->amplifier = on;
}

static void trip(HDerror error) {
    push_error(error, 0);
    omni.arm.off_until_s = omni.elapsed_s + OFF_S;
    set_amplifier();
}

static double converted(double value, double full_scale) {
    double steps = round(value / full_scale * CONVERTER_STEPS);
    return fmax(-CONVERTER_STEPS, fmin(CONVERTER_STEPS, steps)) * full_scale / CONVERTER_STEPS;
}

/* Convert the held output to a force at the tip, at the arm's present position. */
static void feel_motors(void) {
    Arm *arm = &omni.arm;
    if (arm->torque_mode) {
        double q[3];
        arm_inverse(arm->position_m, q);
        arm_torque_to_force(q, arm->output_n_m, arm->delivered_n);
    } else {
        memcpy(arm->delivered_n, arm->output_n, sizeof arm->delivered_n);
    }
}

void arm_command(const double force_n[3], const double torque_n_m[3], int torque_mode) {
    Arm *arm = &omni.arm;
    const int *enabled = omni.device.enabled;
    double force[3], torque[3] = {0.0, 0.0, 0.0};
    if (torque_mode) {
        memcpy(torque, torque_n_m, sizeof torque);
        arm_torque_to_force(arm->ready.joints_rad, torque, force);
    } else {
        memcpy(force, force_n, sizeof force);
    }
    double size = norm(force);
    if (!isfinite(size) || !isfinite(norm(torque))) {
        push_error(HD_FORCE_ERROR, 0);
        arm_silence();
        return;
    }
    memcpy(arm->commanded_n, force, sizeof force);
    arm->command_age_s = 0.0;
    if (size > OMNI_MAX_FORCE_N && enabled[CAP_MAX_FORCE_CLAMPING]) {
        scale(force, OMNI_MAX_FORCE_N / size);
        scale(torque, OMNI_MAX_FORCE_N / size);
        size = OMNI_MAX_FORCE_N;
    }
    double step[3];
    for (int i = 0; i < 3; i++) {
        step[i] = force[i] - arm->previous_n[i];
    }
    memcpy(arm->previous_n, force, sizeof force);
    /* Between the frames' ends, not of the scheduler: a callback may come late in its tick. */
    double now_s = scheduler_now();
    double period_ms = 1e3 * fmax(now_s - arm->previous_s, 1.0 / omni.scheduler.rate_hz);
    arm->previous_s = now_s;
    if (size > OMNI_MAX_FORCE_N * (1.0 + 1e-9) && enabled[CAP_SOFTWARE_FORCE_LIMIT]) {
        trip(HD_EXCEEDED_MAX_FORCE);
    }
    if (norm(step) / period_ms > omni.device.impulse_limit_n_ms &&
        enabled[CAP_SOFTWARE_FORCE_IMPULSE_LIMIT]) {
        trip(HD_EXCEEDED_MAX_FORCE_IMPULSE);
    }
    set_amplifier();
    if (!arm->amplifier) {
        if (arm->warm && size > 0.0 && omni.elapsed_s >= arm->warm_told_s + TELL_AGAIN_S) {
            arm->warm_told_s = omni.elapsed_s;
            push_error(HD_WARM_MOTORS, 0);
        }
        return;
    }
    if (size > arm->ramp_n && enabled[CAP_FORCE_RAMPING]) {
        scale(force, arm->ramp_n / size);
        scale(torque, arm->ramp_n / size);
    }
    arm->torque_mode = torque_mode;
    for (int i = 0; i < 3; i++) {
        arm->output_n[i] = torque_mode ? 0.0 : converted(force[i], OMNI_MAX_FORCE_N);
        arm->output_n_m[i] = torque_mode ? converted(torque[i], OMNI_FULL_SCALE_N_M) : 0.0;
    }
    feel_motors();
}

void arm_silence(void) {
    memset(omni.arm.commanded_n, 0, sizeof omni.arm.commanded_n);
    memset(omni.arm.previous_n, 0, sizeof omni.arm.previous_n);
    omni.arm.previous_s = scheduler_now();
    silence_motors();
    set_amplifier();
}

static void warm_motors(double dt_s) {
    Arm *arm = &omni.arm;
    double q[3], torque[3], hottest = 0.0;
    arm_inverse(arm->position_m, q);
    arm_force_to_torque(q, arm->delivered_n, torque);
    double part = -expm1(-dt_s / omni.settings.thermal_s);
    for (int i = 0; i < 3; i++) {
        double current = torque[i] / CONTINUOUS_N_M[i];
        arm->temperature[i] += (current * current - arm->temperature[i]) * part;
        arm->shown_temperature[i] = fmax(arm->temperature[i], omni.fault[FAULT_WARM_MOTORS]);
        hottest = fmax(hottest, arm->shown_temperature[i]);
    }
    if (!arm->warm && hottest >= 1.0) {
        arm->warm = 1;
        arm->warm_told_s = omni.elapsed_s;
        push_error(HD_WARM_MOTORS, 0);
    } else if (arm->warm && hottest < COOL) {
        arm->warm = 0;
    }
}

/* --- dynamics -------------------------------------------------------------------------------- */

/* Keep `position` within the stops; the outward normal of what was hit, else 0. */
static int stopped(double position[3], double normal[3]) {
    double free_m[3];
    memcpy(free_m, position, sizeof free_m);
    for (int i = 0; i < 3; i++) {
        position[i] = fmax(STOP_LOW_M[i], fmin(STOP_HIGH_M[i], position[i]));
    }
    double out[3] = {position[0], position[1] - L3, position[2] + L4};
    double reach = norm(out);
    if (reach > REACH_M) {
        position[0] = out[0] * REACH_M / reach;
        position[1] = out[1] * REACH_M / reach + L3;
        position[2] = out[2] * REACH_M / reach - L4;
    }
    for (int i = 0; i < 3; i++) {
        normal[i] = free_m[i] - position[i];
    }
    double depth_m = norm(normal);
    if (depth_m <= 0.0) {
        return 0;
    }
    for (int i = 0; i < 3; i++) {
        normal[i] /= depth_m;
    }
    return 1;
}

static void sub_step(double dt) {
    Arm *arm = &omni.arm;
    Hand *hand = &omni.hand;
    const Settings *settings = &omni.settings;
    hand_advance(omni.elapsed_s, dt);
    omni.elapsed_s += dt;
    if (arm->locked && !hand->docked) {
        arm->locked = 0;
    }
    if (arm->locked) {
        return;
    }
    int held = hand->gripped || hand->docked;
    double stylus_kg = settings->mass_kg;
    double mass_kg = stylus_kg + (held ? settings->hand_mass_kg : 0.0);
    double speed = norm(arm->velocity_m_s);
    double drag = settings->viscous_n_s_m +
                  (speed > 1e-9 ? settings->friction_n * tanh(speed / FRICTION_SPEED_M_S) / speed
                                : settings->friction_n / FRICTION_SPEED_M_S);
    double grip_n_s_m = held ? settings->hand_damping_n_s_m : 0.0;
    feel_motors();
    double position[3], middle[3], fixed_n[3], stretch[3], stiffness[3];
    for (int i = 0; i < 3; i++) {
        stiffness[i] = held ? hand->stiffness_n_m[i] : 0.0;
        stretch[i] = hand->target_m[i] - arm->position_m[i];
        fixed_n[i] = held ? hand->push_n[i] : 0.0;
        double world_n = arm->world_push_n[i] - (i == 1 && !held ? settings->droop_n : 0.0);
        middle[i] = (2.0 * mass_kg / dt * arm->velocity_m_s[i] + stiffness[i] * stretch[i] +
                     grip_n_s_m * hand->target_velocity_m_s[i] + fixed_n[i] + world_n +
                     arm->delivered_n[i]) /
                    (2.0 * mass_kg / dt + 0.5 * dt * stiffness[i] + grip_n_s_m + drag);
        position[i] = arm->position_m[i] + dt * middle[i];
    }
    double normal[3], after[3], outward = 0.0;
    int hit = stopped(position, normal);
    for (int i = 0; i < 3; i++) {
        if (hit) {
            middle[i] = (position[i] - arm->position_m[i]) / dt;
        }
        after[i] = 2.0 * middle[i] - arm->velocity_m_s[i];
        outward += hit ? normal[i] * after[i] : 0.0;
    }
    double gained = 0.0, worked = 0.0;
    for (int i = 0; i < 3; i++) {
        if (hit) { /* no bounce, and no grip: what is along the stop goes on */
            after[i] -= outward * normal[i];
        }
        double before = arm->velocity_m_s[i];
        double way = dt * middle[i];
        double world_n = arm->world_push_n[i] - (i == 1 && !held ? settings->droop_n : 0.0);
        double hand_n = 0.0, hand_kg = 0.0;
        if (held) {
            hand_n = stiffness[i] * (stretch[i] - 0.5 * way) +
                     grip_n_s_m * (hand->target_velocity_m_s[i] - middle[i]) + fixed_n[i];
            hand_kg = settings->hand_mass_kg;
        }
        /* The hand's mass gives and takes its kinetic energy, also in the blow of a stop. */
        double hand_j = (hand_n + world_n) * way -
                        0.5 * hand_kg * (after[i] * after[i] - before * before);
        arm->hand_force_n[i] = hand_n - hand_kg * (after[i] - before) / dt;
        arm->hand_j += hand_j;
        arm->delivered_j += arm->delivered_n[i] * way;
        arm->lost_j += drag * middle[i] * way;
        worked += hand_j + (arm->delivered_n[i] - drag * middle[i]) * way;
        gained += 0.5 * stylus_kg * (after[i] * after[i] - before * before);
        arm->velocity_m_s[i] = after[i];
        arm->position_m[i] = position[i];
    }
    if (hit) { /* what the stop took */
        arm->lost_j += worked - gained;
    }
    if (hand->docked) {
        double away[3];
        for (int i = 0; i < 3; i++) {
            away[i] = arm->position_m[i] - INKWELL_M[i];
        }
        if (norm(away) < DOCK_WITHIN_M) {
            speed = norm(arm->velocity_m_s);
            arm->lost_j += 0.5 * stylus_kg * speed * speed;
            memcpy(arm->position_m, INKWELL_M, sizeof arm->position_m);
            memset(arm->velocity_m_s, 0, sizeof arm->velocity_m_s);
            memset(arm->hand_force_n, 0, sizeof arm->hand_force_n);
            arm->locked = 1;
            set_amplifier();
        }
    }
}

void arm_advance(double dt_s) {
    Arm *arm = &omni.arm;
    int steps = (int)ceil(dt_s / SUB_STEP_S - 1e-6);
    if (steps < 1) {
        return;
    }
    double dt = dt_s / steps;
    for (int i = 0; i < steps; i++) {
        arm->command_age_s += dt;
        if (arm->command_age_s > UNFED_S) {
            int fed = norm(arm->delivered_n) > 0.0;
            arm_silence();
            if (fed) {
                log_row(omni.scheduler.tick_s - (steps - i) * dt);
            }
        }
        sub_step(dt);
    }
    if (omni.hand.gripped && !arm->locked) {
        double part = -expm1(-dt_s / TURN_LAG_S);
        for (int i = 0; i < 3; i++) {
            arm->turn_rad[i] += (omni.hand.turn_rad[i] - arm->turn_rad[i]) * part;
        }
    }
}

void simPush(const double force_n[3]) {
    omni_enter();
    memcpy(omni.arm.world_push_n, force_n, sizeof omni.arm.world_push_n);
    omni_leave();
}

/* --- sensors --------------------------------------------------------------------------------- */

static void read_buttons(Sample *sample) {
    Arm *arm = &omni.arm;
    int level = omni.hand.buttons;
    double bounce_ms = omni.fault[FAULT_BUTTON_BOUNCE];
    if (level != arm->button_level) {
        arm->button_shown = arm->button_level ^ level;
        arm->button_level = level;
        arm->bounce_until_s = bounce_ms > 0.0 ? omni.elapsed_s + 1e-3 * bounce_ms : 0.0;
    }
    sample->buttons = level;
    if (omni.elapsed_s < arm->bounce_until_s && omni_random(&omni.random) < 0.5) {
        sample->buttons ^= arm->button_shown;
    }
}

/* Potentiometers: what the converter reads has moved by the next tick. */
static void disturb_gimbal(void) {
    for (int i = 0; i < 3; i++) {
        omni.arm.gimbal_noise[i] =
            omni.settings.gimbal_noise_lsb * (omni_random(&omni.noise) - 0.5);
    }
}

double arm_gimbal_of(long count) { return (double)(count - 2048) * GIMBAL_COUNT_RAD; }

static void read_sensors(Sample *sample) {
    Arm *arm = &omni.arm;
    double joints[3], wanted[3][3], turn[3][3], gimbal[3];
    arm_inverse(arm->position_m, joints);
    about(2, arm->turn_rad[2], wanted);
    about(1, arm->turn_rad[1], turn);
    multiply(wanted, wanted, turn);
    about(0, arm->turn_rad[0], turn);
    multiply(wanted, wanted, turn);
    point_gimbal(joints, wanted, arm->gimbal_rad);
    for (int i = 0; i < 3; i++) {
        sample->encoders[i] = lround((joints[i] - arm->encoder_zero_rad[i]) / COUNT_RAD);
        if (arm->stuck_joint == i + 1) {
            sample->encoders[i] = arm->stuck_count;
        }
        sample->joints_rad[i] = (double)(sample->encoders[i] + arm->correction[i]) * COUNT_RAD;
        long count = lround(arm->gimbal_rad[i] / GIMBAL_COUNT_RAD + arm->gimbal_noise[i]) + 2048;
        count = count < 0 ? 0 : count > 4095 ? 4095 : count;
        sample->encoders[3 + i] = count;
        gimbal[i] = arm_gimbal_of(count);
        sample->gimbal_rad[i] =
            omni.settings.gimbal_scale[i] * gimbal[i] + omni.settings.gimbal_offset_rad[i];
    }
    arm_forward(sample->joints_rad, sample->position_m);
    arm_rotation(sample->joints_rad, gimbal, sample->rotation);
    for (int i = 0; i < 9; i++) { /* slightly not orthogonal, as the library's is */
        sample->rotation[i / 3][i % 3] = round(sample->rotation[i / 3][i % 3] * 1e5) * 1e-5;
    }
    sample->docked = arm->locked;
}

static void smooth(const double now[3], double last[3], double stage[2][3], double dt_s,
                   int angles, double out[3]) {
    double part = -expm1(-2.0 * PI * FILTER_HZ * dt_s);
    for (int i = 0; i < 3; i++) {
        double change = now[i] - last[i];
        double rate = (angles ? wrapped(change) : change) / dt_s;
        last[i] = now[i];
        stage[0][i] += (rate - stage[0][i]) * part;
        stage[1][i] += (stage[0][i] - stage[1][i]) * part;
        out[i] = stage[1][i];
    }
}

void arm_sample_now(void) {
    Arm *arm = &omni.arm;
    Sample *sample = &arm->fresh;
    disturb_gimbal();
    read_sensors(sample);
    sample->buttons = omni.hand.buttons;
    memcpy(arm->last_position_m, sample->position_m, sizeof arm->last_position_m);
    memcpy(arm->last_gimbal_rad, sample->gimbal_rad, sizeof arm->last_gimbal_rad);
    arm->ready = *sample;
}

void arm_tick(double dt_s) {
    Arm *arm = &omni.arm;
    Device *device = &omni.device;
    arm->ready = arm->fresh;
    Sample *sample = &arm->fresh;
    disturb_gimbal();
    read_sensors(sample);
    read_buttons(sample);
    smooth(sample->position_m, arm->last_position_m, arm->velocity_stage, dt_s, 0,
           sample->velocity_m_s);
    smooth(sample->gimbal_rad, arm->last_gimbal_rad, arm->gimbal_stage, dt_s, 1,
           sample->gimbal_rad_s);
    warm_motors(dt_s);
    /* In the inkwell there is no force to switch off, and calibration makes the position jump. */
    if (device->initiated && omni.scheduler.started && arm_connected() && !arm->locked) {
        int too_fast = norm(sample->velocity_m_s) > device->velocity_limit_m_s;
        if (too_fast && device->enabled[CAP_SOFTWARE_VELOCITY_LIMIT]) {
            if (!arm->too_fast) {
                trip(HD_EXCEEDED_MAX_VELOCITY);
            }
            arm->off_until_s = omni.elapsed_s + OFF_S;
        }
        arm->too_fast = too_fast;
        double per_s = omni.fault[FAULT_OVER_FORCE];
        if (per_s > 0.0 && omni.elapsed_s >= arm->over_force_s) {
            arm->over_force_s = omni.elapsed_s + 1.0 / per_s;
            trip(HD_EXCEEDED_MAX_FORCE);
        }
    }
    set_amplifier();
    if (arm->amplifier) {
        arm->ramp_n = fmin(arm->ramp_n + device->ramping_n_s * dt_s, 2.0 * OMNI_MAX_FORCE_N);
    }
}

void arm_lose_calibration(void) {
    Arm *arm = &omni.arm;
    arm->calibrated = 0;
    for (int i = 0; i < 3; i++) {
        arm->correction[i] += lround(0.2 * (omni_random(&omni.random) - 0.5) / COUNT_RAD);
    }
}

void arm_calibrate(void) {
    Arm *arm = &omni.arm;
    Sample before;
    double inkwell[3];
    read_sensors(&before);
    arm_inverse(INKWELL_M, inkwell);
    for (int i = 0; i < 3; i++) {
        arm->correction[i] = lround(inkwell[i] / COUNT_RAD) - before.encoders[i];
    }
    arm->calibrated = 1; /* the position jumps, and for a while so does the filtered velocity */
}

/* Switched on where it is: an arm that is not calibrated takes that for the inkwell. */
static void forget_position(void) {
    Arm *arm = &omni.arm;
    double here[3], inkwell[3];
    arm_inverse(arm->position_m, here);
    arm_inverse(INKWELL_M, inkwell);
    for (int i = 0; i < 3; i++) {
        arm->encoder_zero_rad[i] = here[i] - inkwell[i];
        arm->correction[i] = 0;
    }
    arm->calibrated = 0;
}

void arm_power_on(void) {
    Arm *arm = &omni.arm;
    double unused[3];
    if (omni.hand.docked) {
        memcpy(arm->position_m, INKWELL_M, sizeof arm->position_m);
        arm->locked = 1;
    } else {
        memcpy(arm->position_m, omni.hand.target_m, sizeof arm->position_m);
        stopped(arm->position_m, unused);
    }
    memcpy(arm->turn_rad, omni.hand.turn_rad, sizeof arm->turn_rad);
    arm->calibrated = 1;
    if (!omni.settings.calibrated) {
        forget_position();
    }
    arm->button_level = omni.hand.buttons;
    arm->ramp_n = 0.0;
    arm_sample_now();
}

void omni_set_fault(Fault fault, double value) {
    Arm *arm = &omni.arm;
    double before = omni.fault[fault];
    omni.fault[fault] = value;
    switch (fault) {
    case FAULT_UNCALIBRATED:
        if (value != 0.0) {
            arm_lose_calibration();
        }
        break;
    case FAULT_STUCK_ENCODER:
        arm->stuck_joint = (int)value;
        if (arm->stuck_joint) {
            arm->stuck_count = arm->fresh.encoders[arm->stuck_joint - 1];
        }
        break;
    case FAULT_OVER_FORCE:
        arm->over_force_s = omni.elapsed_s;
        break;
    case FAULT_UNPLUG:
        if (value != 0.0) {
            omni.device.gone = omni.device.initiated;
        } else if (before != 0.0) { /* plugged in: switched on anew */
            forget_position();
        }
        break;
    default:
        break;
    }
    set_amplifier();
}
