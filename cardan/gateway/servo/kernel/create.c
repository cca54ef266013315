#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "internal.h"
#include "vectors.h"

/* Rotations and axes may be so far from exact. */
#define UNIT_TOLERANCE 1e-6

static bool is_rotation(const double rotation[9])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            if (!(fabs(dot3(rotation + 3 * i, rotation + 3 * j) - (i == j)) < UNIT_TOLERANCE))
                return false;
    double across[3];
    cross3(rotation, rotation + 3, across);
    return dot3(across, rotation + 6) > 0.0;
}

static bool is_unit(const double vector[3])
{
    return fabs(dot3(vector, vector) - 1.0) < UNIT_TOLERANCE;
}

static bool limits_are_sound(const double *velocity, const double *acceleration, int joints)
{
    return all_within(velocity, joints, DBL_MIN, LARGEST) &&
           all_within(acceleration, joints, DBL_MIN, LARGEST);
}

static bool options_are_sound(const KernelOptions *options)
{
    const double *values = &options->length_m;
    return all_within(values, sizeof *options / sizeof *values, 0.0, LARGEST) &&
           options->length_m > 0.0;
}

static int32_t arm_problem(const KernelArm *arm)
{
    if (arm->joints < 1 || arm->joints > MAX_JOINTS)
        return KERNEL_BAD_JOINTS;
    bool weighed = false;
    for (int i = 0; i < arm->joints; i++) {
        if (!is_rotation(arm->rotation[i]) || !is_unit(arm->axis[i]) ||
            !all_within(arm->position[i], 3, -LARGEST, LARGEST))
            return KERNEL_BAD_JOINTS;
        bool ordered = arm->lower[i] < arm->upper[i]; /* false for NaN */
        if (!ordered)
            return KERNEL_BAD_LIMITS;
    }
    if (!limits_are_sound(arm->velocity, arm->acceleration, arm->joints))
        return KERNEL_BAD_LIMITS;
    if (!all_within(arm->weights, 6, 0.0, LARGEST))
        return KERNEL_BAD_WEIGHTS;
    for (int i = 0; i < 6; i++)
        weighed |= arm->weights[i] > 0.0;
    return weighed ? KERNEL_MADE : KERNEL_BAD_WEIGHTS;
}

static bool shape_is_sound(const KernelShape *shape, int joints)
{
    if (shape->body < 0 || shape->body > joints)
        return false;
    switch (shape->kind) {
    case SHAPE_CAPSULE:
        return all_within(shape->start, 3, -LARGEST, LARGEST) &&
               all_within(shape->end, 3, -LARGEST, LARGEST) &&
               all_within(&shape->radius_m, 1, 0.0, LARGEST);
    case SHAPE_BOX:
        return is_rotation(shape->rotation) &&
               all_within(shape->position, 3, -LARGEST, LARGEST) &&
               all_within(shape->half_m, 3, 0.0, LARGEST);
    case SHAPE_HALF_SPACE:
        return shape->body == 0 && is_unit(shape->normal) &&
               all_within(&shape->offset_m, 1, -LARGEST, LARGEST);
    default:
        return false;
    }
}

static bool pair_is_sound(const KernelPair *pair, const KernelShape *shapes, size_t count)
{
    if (pair->first < 0 || pair->second < 0 || (size_t)pair->first >= count ||
        (size_t)pair->second >= count)
        return false;
    const KernelShape *first = &shapes[pair->first], *second = &shapes[pair->second];
    return first->body < second->body && all_within(&pair->safety_m, 1, 0.0, LARGEST) &&
           all_within(&pair->deceleration_m_s2, 1, DBL_MIN, LARGEST) &&
           all_within(pair->sweep, MAX_JOINTS, 0.0, DBL_MAX);
}

static int32_t problem(const KernelArm *arm, const KernelOptions *options,
                       const KernelShape *shapes, size_t shape_count, const KernelPair *pairs,
                       size_t pair_count)
{
    int32_t found = arm_problem(arm);
    if (found)
        return found;
    if (!options_are_sound(options))
        return KERNEL_BAD_OPTIONS;
    if (shape_count > MAX_SHAPES)
        return KERNEL_BAD_SHAPE;
    for (size_t i = 0; i < shape_count; i++)
        if (!shape_is_sound(&shapes[i], arm->joints))
            return KERNEL_BAD_SHAPE;
    if (pair_count > MAX_PAIRS)
        return KERNEL_BAD_PAIR;
    for (size_t i = 0; i < pair_count; i++)
        if (!pair_is_sound(&pairs[i], shapes, shape_count))
            return KERNEL_BAD_PAIR;
    return KERNEL_MADE;
}

static void set_task(Kernel *kernel, const KernelArm *arm)
{
    int counted = 0;
    for (int i = 0; i < 6; i++) {
        double weight = arm->weights[i], length = i < 3 ? 1.0 : kernel->options.length_m;
        kernel->weights[i] = weight * length;
        /* Priorities among directions must not make an arm look singular. */
        kernel->scales[i] = weight != 0.0 ? length : 0.0;
        if (weight != 0.0)
            kernel->directions[counted++] = i;
    }
    kernel->counted = counted;
    int rank = counted < arm->joints ? counted : arm->joints;
    kernel->full_rank = rank == 6;
    kernel->smallest = arm->joints - rank;
}

static void set_gains(Kernel *kernel)
{
    /* For errors so small the gain alone counts: not fast, and far from overshooting. */
    const KernelOptions *options = &kernel->options;
    double gain = options->gain_1_s, square = gain * gain;
    kernel->small_m = smaller(0.5 * options->linear_deceleration_m_s2 / square,
                           options->linear_speed_m_s / gain);
    kernel->small_rad = smaller(0.5 * options->angular_deceleration_rad_s2 / square,
                             options->angular_speed_rad_s / gain);
}

static bool take_memory(Kernel *kernel, size_t shapes, size_t pairs)
{
    kernel->shapes = calloc(shapes + 1, sizeof *kernel->shapes);
    kernel->bodies = calloc(shapes + 1, sizeof *kernel->bodies);
    kernel->ahead = calloc(shapes + 1, sizeof *kernel->ahead);
    kernel->pairs = calloc(pairs + 1, sizeof *kernel->pairs);
    kernel->separations = calloc(pairs + 1, sizeof *kernel->separations);
    kernel->placed = calloc(shapes + 1, sizeof *kernel->placed);
    kernel->near = calloc(pairs + 1, sizeof *kernel->near);
    kernel->room = calloc(pairs + 1, sizeof *kernel->room);
    kernel->clear_m = calloc(pairs + 1, sizeof *kernel->clear_m);
    kernel->groups = calloc(pairs + 1, sizeof *kernel->groups);
    kernel->group = calloc(pairs + 1, sizeof *kernel->group);
    kernel->order = calloc(pairs + 1, sizeof *kernel->order);
    kernel->grown_m = calloc(shapes + 1, sizeof *kernel->grown_m);
    return kernel->shapes && kernel->bodies && kernel->ahead && kernel->pairs &&
           kernel->separations && kernel->placed && kernel->near && kernel->room && kernel->clear_m &&
           kernel->groups && kernel->group && kernel->order && kernel->grown_m;
}

/* By their two bodies. */
static void group_pairs(Kernel *kernel)
{
    memset(kernel->group_of, -1, sizeof kernel->group_of);
    for (size_t i = 0; i < kernel->pair_count; i++) {
        const KernelPair *pair = &kernel->pairs[i];
        int32_t low = kernel->shapes[pair->first].body, high = kernel->shapes[pair->second].body;
        int32_t *number = &kernel->group_of[low][high];
        if (*number < 0) {
            *number = (int32_t)kernel->group_count++;
            kernel->groups[*number].deceleration_m_s2 = INFINITY;
        }
        kernel->group[i] = *number;
        PairGroup *group = &kernel->groups[*number];
        group->low = low;
        group->high = high;
        group->beyond++;
        for (int j = 0; j < kernel->n; j++) {
            group->sweep[j] = larger(group->sweep[j], pair->sweep[j]);
            kernel->farthest[j] = larger(kernel->farthest[j], pair->sweep[j]);
        }
        group->safety_m = larger(group->safety_m, pair->safety_m);
        group->deceleration_m_s2 = smaller(group->deceleration_m_s2, pair->deceleration_m_s2);
    }
    size_t before = 0;
    for (size_t i = 0; i < kernel->group_count; i++) {
        size_t count = kernel->groups[i].beyond;
        kernel->groups[i].first = kernel->groups[i].beyond = before;
        before += count;
    }
    for (size_t i = 0; i < kernel->pair_count; i++)
        kernel->order[kernel->groups[kernel->group[i]].beyond++] = (int32_t)i;
}

/* Points of a shape in the frame of its body, of which each has a ball of the returned radius: they
 * are its hull. */
static double hull(const KernelShape *shape, double points[8][3], int *count)
{
    if (shape->kind == SHAPE_CAPSULE) {
        copy3(shape->start, points[0]);
        copy3(shape->end, points[1]);
        *count = 2;
        return shape->radius_m;
    }
    *count = 8;
    for (int which = 0; which < 8; which++) {
        double corner[3], turned[3];
        for (int i = 0; i < 3; i++)
            corner[i] = which >> i & 1 ? shape->half_m[i] : -shape->half_m[i];
        turn3(shape->rotation, corner, turned);
        along3(shape->position, 1.0, turned, points[which]);
    }
    return 0.0;
}

/* A ball around the shapes of `body`: about the middle of the box, along its axes, around them. */
static void surround(Kernel *kernel, int body)
{
    Ball *ball = &kernel->balls[body];
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    double points[8][3], away[3];
    int count;
    for (int twice = 0; twice < 2; twice++) {
        for (size_t i = 0; i < kernel->shape_count; i++) {
            if (kernel->shapes[i].body != body)
                continue;
            double around_m = hull(&kernel->shapes[i], points, &count);
            for (int point = 0; point < count; point++) {
                for (int axis = 0; axis < 3 && !twice; axis++) {
                    low[axis] = smaller(low[axis], points[point][axis] - around_m);
                    high[axis] = larger(high[axis], points[point][axis] + around_m);
                }
                subtract3(points[point], ball->middle, away);
                if (twice)
                    ball->radius_m = larger(ball->radius_m, norm3(away) + around_m);
            }
        }
        for (int axis = 0; axis < 3 && !twice && low[axis] <= high[axis]; axis++)
            ball->middle[axis] = 0.5 * (low[axis] + high[axis]);
    }
}

Kernel *kernel_create(const KernelArm *arm, const KernelOptions *options,
                      const KernelShape *shapes, size_t shape_count, const KernelPair *pairs,
                      size_t pair_count, int32_t *reason)
{
    *reason = problem(arm, options, shapes, shape_count, pairs, pair_count);
    if (*reason)
        return NULL;
    Kernel *kernel = calloc(1, sizeof *kernel);
    if (!kernel || !take_memory(kernel, shape_count, pair_count)) {
        kernel_destroy(kernel);
        *reason = KERNEL_NO_MEMORY;
        return NULL;
    }
    int n = kernel->n = kernel->chain.joints = arm->joints;
    kernel->options = *options;
    for (int i = 0; i < n; i++) {
        Placement placement;
        memcpy(placement.rotation, arm->rotation[i], sizeof placement.rotation);
        copy3(arm->position[i], placement.position);
        chain_set_joint(&kernel->chain, i, &placement, arm->axis[i], arm->prismatic[i]);
        kernel->lower[i] = arm->lower[i];
        kernel->upper[i] = arm->upper[i];
        kernel->velocity[i] = arm->velocity[i];
        kernel->acceleration[i] = arm->acceleration[i];
    }
    for (int i = 0; i < 9; i += 4)
        kernel->chain.tool.rotation[i] = kernel->pose.bodies[0].rotation[i] = 1.0;
    set_task(kernel, arm);
    set_gains(kernel);
    kernel->shape_count = shape_count;
    kernel->pair_count = pair_count;
    if (shape_count)
        memcpy(kernel->shapes, shapes, shape_count * sizeof *shapes);
    if (pair_count)
        memcpy(kernel->pairs, pairs, pair_count * sizeof *pairs);
    group_pairs(kernel);
    for (int body = 1; body <= n; body++)
        surround(kernel, body);
    for (size_t i = 0; i < shape_count; i++)
        if (shapes[i].body == 0) {
            body_place(&shapes[i], &kernel->pose.bodies[0], &kernel->bodies[i]);
            kernel->ahead[i] = kernel->bodies[i];
        }
    kernel->nearest_m = INFINITY;
    kernel->state.smallest_singular_value = INFINITY;
    kernel->state.goal_orientation[0] = 1.0;
    const double zero[MAX_JOINTS] = {0.0};
    kernel_place(kernel, zero);
    return kernel;
}

void kernel_destroy(Kernel *kernel)
{
    if (!kernel)
        return;
    free(kernel->shapes);
    free(kernel->bodies);
    free(kernel->ahead);
    free(kernel->pairs);
    free(kernel->separations);
    free(kernel->placed);
    free(kernel->near);
    free(kernel->room);
    free(kernel->clear_m);
    free(kernel->groups);
    free(kernel->group);
    free(kernel->order);
    free(kernel->grown_m);
    free(kernel);
}

int32_t kernel_move(Kernel *kernel, size_t first, size_t count, const double *placements,
                    const double *grown_m)
{
    if (first > kernel->shape_count || count > kernel->shape_count - first ||
        !all_within(grown_m, count, 0.0, LARGEST))
        return false;
    for (size_t i = 0; i < count; i++)
        if (kernel->shapes[first + i].body != 0 || !is_rotation(placements + 12 * i) ||
            !all_within(placements + 12 * i + 9, 3, -LARGEST, LARGEST))
            return false;
    for (size_t i = 0; i < count; i++) {
        Placement placement;
        memcpy(placement.rotation, placements + 12 * i, sizeof placement.rotation);
        copy3(placements + 12 * i + 9, placement.position);
        size_t shape = first + i;
        body_place(&kernel->shapes[shape], &placement, &kernel->bodies[shape]);
        kernel->ahead[shape] = kernel->bodies[shape];
        kernel->grown_m[shape] = grown_m[i];
    }
    for (size_t i = 0; i < kernel->pair_count; i++) {
        size_t shape = (size_t)kernel->pairs[i].first;
        if (shape >= first && shape - first < count)
            kernel->clear_m[i] = kernel->groups[kernel->group[i]].clear_m = -INFINITY;
    }
    return true;
}

KernelState *kernel_state(Kernel *kernel)
{
    return &kernel->state;
}

int32_t kernel_set_tool(Kernel *kernel, const double rotation[9], const double position[3])
{
    if (!is_rotation(rotation) || !all_within(position, 3, -LARGEST, LARGEST))
        return false;
    memcpy(kernel->chain.tool.rotation, rotation, sizeof kernel->chain.tool.rotation);
    copy3(position, kernel->chain.tool.position);
    return true;
}
