/*
 * Fuzzes the servo's kernel: random arms, shapes, options, goals and programs, many of them
 * nonsense.
 *
 *     tools/native --fuzz servo PROGRAM -g -fsanitize=address,undefined -fno-sanitize-recover=all
 *     PROGRAM [SECONDS] [SEED]
 *
 * Ends with 1 and says what was wrong where a kernel that was made gives joints that are no numbers,
 * moves faster than its joints may, or needs more iterations than there may be. The sanitizers look
 * for everything else.
 */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "kernel.h"

static uint64_t state;

static uint64_t random_bits(void)
{
    /* xorshift64* */
    state ^= state >> 12;
    state ^= state << 25;
    state ^= state >> 27;
    return state * 2685821657736338717ull;
}

static double uniform(double low, double high)
{
    return low + (high - low) * (double)(random_bits() >> 11) * 0x1p-53;
}

static int below(int end)
{
    return (int)(random_bits() % (uint64_t)end);
}

static bool one_in(int count)
{
    return below(count) == 0;
}

static double bad_share; /* of all numbers, those that are strange */

static double strange(void)
{
    static const double VALUES[] = {NAN,    INFINITY, -INFINITY, 0.0,    -0.0,  1e308, -1e308,
                                    1e154,  1e-320,   -1e-320,   1e-12,  1e9,   -1e9,  1.0,
                                    -1.0,   1e-300,   1e16,      3.2e-8, 1e100, 2.0};
    if (one_in(4)) {
        uint64_t bits = random_bits();
        double value;
        memcpy(&value, &bits, sizeof value);
        return value;
    }
    return VALUES[below((int)(sizeof VALUES / sizeof *VALUES))];
}

static double number(double low, double high)
{
    return uniform(0.0, 1.0) < bad_share ? strange() : uniform(low, high);
}

static void numbers(double *out, int count, double low, double high)
{
    for (int i = 0; i < count; i++)
        out[i] = number(low, high);
}

static void unit(double out[3])
{
    double length;
    do {
        for (int i = 0; i < 3; i++)
            out[i] = uniform(-1.0, 1.0);
        length = sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2]);
    } while (!(length > 0.1));
    for (int i = 0; i < 3; i++)
        out[i] /= length;
    if (one_in(3)) {
        int axis = below(3);
        for (int i = 0; i < 3; i++)
            out[i] = i == axis ? (one_in(2) ? 1.0 : -1.0) : 0.0;
    }
    if (uniform(0.0, 1.0) < bad_share)
        out[below(3)] = strange();
}

static void rotation(double out[9])
{
    double q[4];
    for (int i = 0; i < 4; i++)
        q[i] = one_in(4) ? 0.0 : uniform(-1.0, 1.0);
    if (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] < 1e-3)
        q[0] = 1.0;
    quaternion_to_rotation(q, out);
    if (uniform(0.0, 1.0) < bad_share)
        out[below(9)] = strange();
}

static void random_arm(KernelArm *arm)
{
    memset(arm, 0, sizeof *arm);
    arm->joints = one_in(20) ? below(40) - 20 : 1 + below(MAX_JOINTS);
    bool alike = one_in(2);
    for (int i = 0; i < MAX_JOINTS; i++) {
        arm->prismatic[i] = one_in(4);
        rotation(arm->rotation[i]);
        numbers(arm->position[i], 3, -0.5, 0.5);
        if (one_in(5))
            memset(arm->position[i], 0, sizeof arm->position[i]);
        unit(arm->axis[i]);
        arm->lower[i] = one_in(5) ? -INFINITY : number(-3.0, 0.0);
        arm->upper[i] = one_in(5) ? INFINITY : number(0.0, 3.0);
        arm->velocity[i] = number(0.01, 5.0);
        arm->acceleration[i] = number(0.1, 50.0);
    }
    for (int i = 0; i < 6; i++)
        arm->weights[i] = alike ? 1.0 : one_in(3) ? 0.0 : number(0.0, 2.0);
}

static void random_options(KernelOptions *options)
{
    numbers(&options->length_m, (int)(sizeof *options / sizeof(double)), 1e-6, 1.0);
    options->gain_1_s = number(0.0, 100.0);
    if (one_in(4)) {
        options->damping = options->damping_floor = 0.0;
        options->path_stiffness = 0.0;
    }
}

static void random_shape(KernelShape *shape, int joints)
{
    memset(shape, 0, sizeof *shape);
    shape->kind = one_in(100) ? below(20) - 10 : below(3);
    shape->body = shape->kind == SHAPE_HALF_SPACE || one_in(4) ? 0 : below(joints + 1);
    numbers(shape->start, 3, -0.5, 0.5);
    numbers(shape->end, 3, -0.5, 0.5);
    if (one_in(3))
        memcpy(shape->end, shape->start, sizeof shape->end);
    shape->radius_m = one_in(10) ? 0.0 : number(0.0, 0.2);
    rotation(shape->rotation);
    numbers(shape->position, 3, -0.5, 0.5);
    numbers(shape->half_m, 3, 0.0, 0.3);
    if (one_in(10))
        memset(shape->half_m, 0, sizeof shape->half_m);
    unit(shape->normal);
    shape->offset_m = number(-0.5, 0.5);
}

static int wrong(const char *what, uint64_t seed)
{
    fprintf(stderr, "wrong: %s; seed %llu\n", what, (unsigned long long)seed);
    return 1;
}

static int check(const Kernel *kernel, const KernelArm *arm, const KernelState *now, uint64_t seed)
{
    (void)kernel;
    for (int i = 0; i < arm->joints; i++) {
        if (!isfinite(now->q[i]) || !isfinite(now->v[i]))
            return wrong("joints that are no numbers", seed);
    }
    for (int i = 0; i < 6; i++)
        if (now->problem != KERNEL_GOOD && now->twist[i] != 0.0 &&
            now->problem != KERNEL_NO_SOLUTION)
            return wrong("a refused tick that moves its reference", seed);
    if (now->iterations > 2 * MAX_ITERATIONS)
        return wrong("too many iterations", seed);
    if (!(now->path_speed >= 0.0 && now->path_speed <= 1.0) && now->problem == KERNEL_GOOD)
        return wrong("a path speed that is no share", seed);
    return 0;
}

static int drive(uint64_t seed)
{
    KernelArm arm;
    KernelOptions options;
    KernelShape shapes[12];
    KernelPair pairs[40];
    int32_t reason;
    bad_share = one_in(2) ? 0.0 : 0.003;
    random_arm(&arm);
    random_options(&options);
    int joints = arm.joints >= 1 && arm.joints <= MAX_JOINTS ? arm.joints : 1;
    size_t shape_count = (size_t)below(13), pair_count = 0;
    for (size_t i = 0; i < shape_count; i++)
        random_shape(&shapes[i], joints);
    for (int tries = 0; shape_count && tries < 40; tries++) {
        KernelPair *pair = &pairs[pair_count];
        pair->first = below((int)shape_count);
        pair->second = below((int)shape_count);
        pair->safety_m = number(0.0, 0.05);
        pair->deceleration_m_s2 = number(0.1, 5.0);
        numbers(pair->sweep, MAX_JOINTS, 0.0, 2.0);
        bool ordered = shapes[pair->first].body < shapes[pair->second].body;
        if (ordered || one_in(500))
            pair_count++;
    }
    Kernel *kernel = kernel_create(&arm, &options, shapes, shape_count, pairs, pair_count, &reason);
    if (!kernel)
        return reason ? 0 : wrong("refused without a reason", seed);
    KernelState *now = kernel_state(kernel);
    double turned[9], position[3], joints_to[MAX_JOINTS];
    rotation(turned);
    numbers(position, 3, -0.2, 0.2);
    kernel_set_tool(kernel, turned, position);
    int failed = 0;
    for (int tick = 0; tick < 60 && !failed; tick++) {
        bad_share = one_in(8) ? 0.05 : 0.0;
        if (one_in(10)) {
            numbers(joints_to, MAX_JOINTS, -3.0, 3.0);
            kernel_place(kernel, joints_to);
        }
        if (one_in(10)) {
            numbers(joints_to, MAX_JOINTS, -2.0, 2.0);
            kernel_move_at(kernel, joints_to);
        }
        double size = one_in(3) ? 0.0 : one_in(3) ? 10.0 : 0.1;
        kernel_pose(kernel);
        for (int i = 0; i < 3; i++)
            now->goal_position[i] = now->pose_position[i] + number(-0.1, 0.1) * size;
        for (int i = 0; i < 4; i++)
            now->goal_orientation[i] = now->pose_orientation[i] + number(-0.1, 0.1) * size;
        numbers(now->goal_twist, 6, -size, size);
        numbers(now->joint_rate, MAX_JOINTS, -size, size);
        numbers(now->goal_joints, MAX_JOINTS, -3.0, 3.0);
        numbers(now->goal_rate, MAX_JOINTS, -size, size);
        numbers(now->posture, MAX_JOINTS, -3.0, 3.0);
        now->has_posture = one_in(2);
        now->reach = one_in(2);
        double dt_s = one_in(20) ? strange() : uniform(0.0005, 0.005);
        int what = below(10);
        if (what < 7)
            kernel_tick(kernel, dt_s, below(4));
        else if (what < 9)
            kernel_tick_joints(kernel, dt_s);
        else
            kernel_brake(kernel, dt_s);
        kernel_motion(kernel);
        kernel_status(kernel);
        failed = check(kernel, &arm, now, seed);
    }
    kernel_destroy(kernel);
    return failed;
}

static int solve(uint64_t seed)
{
    static Program program;
    bad_share = one_in(3) ? 0.002 : 0.0;
    int n = program.unknowns = 1 + below(MAX_UNKNOWNS);
    program.rows = below(MAX_ROWS + 1);
    if (one_in(2))
        program_forget(&program);
    double task[6][MAX_UNKNOWNS], damping = pow(10.0, uniform(-14.0, 0.0));
    for (int row = 0; row < 6; row++)
        numbers(task[row], n, -1.0, 1.0);
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            program.hessian[i][j] = i == j ? damping : 0.0;
            for (int row = 0; row < 6; row++)
                program.hessian[i][j] += task[row][i] * task[row][j];
        }
        program.linear[i] = number(-1.0, 1.0);
        double one = number(-1.0, 1.0), other = one_in(4) ? one : number(-1.0, 1.0);
        program.lowest[i] = fmin(one, other);
        program.highest[i] = fmax(one, other);
    }
    for (int r = 0; r < program.rows; r++) {
        numbers(program.row[r], n, -1.0, 1.0);
        if (r && one_in(4))
            memcpy(program.row[r], program.row[below(r)], sizeof program.row[r]);
        if (one_in(10))
            memset(program.row[r], 0, sizeof program.row[r]);
        program.least[r] = number(-1.0, 0.5);
        program.row_name[r] = below(100);
    }
    int told = program_solve(&program);
    if (program.iterations > MAX_ITERATIONS)
        return wrong("too many iterations of a program", seed);
    for (int i = 0; !told && i < n; i++)
        if (!(program.x[i] >= program.lowest[i] && program.x[i] <= program.highest[i]) &&
            program.lowest[i] <= program.highest[i])
            return wrong("an unknown outside its bounds", seed);
    return 0;
}

int main(int count, char **words)
{
    double seconds = count > 1 ? atof(words[1]) : 10.0;
    uint64_t seed = count > 2 ? strtoull(words[2], NULL, 10) : 1;
    unsigned long long runs = 0;
    clock_t end = clock() + (clock_t)(seconds * (double)CLOCKS_PER_SEC);
    for (; clock() < end; runs++, seed++) {
        state = seed * 0x9E3779B97F4A7C15ull | 1u;
        random_bits();
        if (drive(seed) || solve(seed) || solve(seed) || solve(seed))
            return 1;
    }
    printf("%llu arms, nothing wrong\n", runs);
    return 0;
}
