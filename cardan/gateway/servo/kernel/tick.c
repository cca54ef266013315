#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "eigen.h"
#include "internal.h"
#include "vectors.h"

/* As in servo.py, which says why. */
#define AT_REST 1e-5
#define POSTURE_FULL_AT_M_S 0.02
#define SLOWED 0.9
#define TIGHT_M_S 1e-4
#define OFF_LINE_M 0.005
#define OFF_LINE_RAD (2.0 * 3.14159265358979323846 / 180.0)
#define LEAST_STIFFNESS 1e-3
#define SWEEPS 10
#define AT_END 1e-3
#define FREE_DIRECTION 1e-9
#define LIMITING 1e-9

static double stopping_speed(double distance, double acceleration, double dt_s)
{
    if (!(distance > 0.0))
        return 0.0;
    double gain = acceleration * dt_s;
    return sqrt(gain * gain + 2.0 * acceleration * distance) - gain;
}

static bool all_finite(const double *values, int count)
{
    for (int i = 0; i < count; i++)
        if (!isfinite(values[i]))
            return false;
    return true;
}

static double product(int n, const double *a, const double *b)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++)
        sum += a[i] * b[i];
    return sum;
}

/* ----------------------------------------------------------------------------------------------
 * Distances */

/* Rather all pairs are looked at anew than how far they came be a sum without digits. */
#define FARTHEST_TRAVEL_M 1e3

/* All pairs of `group` are to be looked at. */
static void forget_group(Kernel *kernel, PairGroup *group)
{
    group->travel_m = 0.0;
    group->clear_m = -INFINITY;
    for (size_t k = group->first; k < group->beyond; k++)
        kernel->clear_m[kernel->order[k]] = -INFINITY;
}

static void forget_distances(Kernel *kernel)
{
    for (size_t i = 0; i < kernel->group_count; i++)
        forget_group(kernel, &kernel->groups[i]);
}

/* The middle of the ball around a body, in the base. */
static void ball_middle(const Kernel *kernel, int body, double middle[3])
{
    const Placement *at = &kernel->pose.bodies[body];
    double turned[3];
    turn3(at->rotation, kernel->balls[body].middle, turned);
    along3(at->position, 1.0, turned, middle);
}

/* The arm is at `kernel->pose`, whose joints `q` are: no pair came nearer than a point of one body
 * moved in the frame of the other since they were looked at. That is not farther than the middle of
 * its ball moved, and the ball turned. */
static void travel(Kernel *kernel, const double *q)
{
    double turned_by[MAX_JOINTS], middle[3], from[3], at[3], moved[3];
    kernel->looks++;
    for (int i = 0; i < kernel->n; i++) {
        turned_by[i] = kernel->chain.prismatic[i] ? 0.0 : fabs(q[i] - kernel->looked_at[i]);
        kernel->looked_at[i] = q[i];
    }
    for (int high = 1; high <= kernel->n; high++) {
        double turned = 0.0;
        ball_middle(kernel, high, middle);
        for (int low = high - 1; low >= 0; low--) {
            int32_t number = kernel->group_of[low][high];
            turned += turned_by[low];
            if (number < 0)
                continue;
            PairGroup *group = &kernel->groups[number];
            subtract3(middle, kernel->pose.bodies[low].position, from);
            turn_back3(kernel->pose.bodies[low].rotation, from, at);
            subtract3(at, group->at, moved);
            copy3(at, group->at);
            group->travel_m += norm3(moved) + turned * kernel->balls[high].radius_m;
            if (!(group->travel_m < FARTHEST_TRAVEL_M))
                forget_group(kernel, group);
        }
    }
}

static const Body *placed(Kernel *kernel, int32_t shape)
{
    int32_t body = kernel->shapes[shape].body;
    if (body > 0 && kernel->placed[shape] != kernel->looks) {
        body_place(&kernel->shapes[shape], &kernel->pose.bodies[body], &kernel->bodies[shape]);
        kernel->placed[shape] = kernel->looks;
    }
    return &kernel->bodies[shape];
}

/* What its distance leaves of how much farther away it is kept than others. */
static double separate_pair(Kernel *kernel, size_t i, double far_m)
{
    const KernelPair *pair = &kernel->pairs[i];
    Separation *found = &kernel->separations[i];
    double grown_m = kernel->grown_m[pair->first];
    body_separation(placed(kernel, pair->first), placed(kernel, pair->second), far_m + grown_m,
                    found);
    double left = found->distance_m - grown_m;
    PairGroup *group = &kernel->groups[kernel->group[i]];
    kernel->clear_m[i] = left + group->travel_m;
    group->clear_m = smaller(group->clear_m, kernel->clear_m[i]);
    return left;
}

/* The pair that was nearest still nearly is: what is farther away than it need not be known. */
static double separate_nearest(Kernel *kernel)
{
    int32_t before = kernel->state.nearest;
    if (before >= 0 && (size_t)before < kernel->pair_count)
        return separate_pair(kernel, (size_t)before, INFINITY);
    kernel->state.nearest = -1;
    return INFINITY;
}

static void note_nearest(Kernel *kernel, double least)
{
    kernel->nearest_m = least;
    bool any = kernel->state.nearest >= 0;
    kernel->state.distance_m =
        any ? kernel->separations[kernel->state.nearest].distance_m : INFINITY;
}

/* Finds the nearest pair, and those below the `far_m` of their groups, which are in `near` then; how
 * many these are. */
static int look(Kernel *kernel)
{
    int count = 0;
    double least = separate_nearest(kernel);
    int32_t before = kernel->state.nearest;
    for (size_t number = 0; number < kernel->group_count; number++) {
        PairGroup *group = &kernel->groups[number];
        double near_m = group->travel_m + group->far_m;
        double far_m = group->travel_m + larger(group->far_m, least), clear_m = INFINITY;
        if (group->clear_m > far_m)
            continue;
        for (size_t k = group->first; k < group->beyond; k++) {
            int32_t i = kernel->order[k];
            if (kernel->clear_m[i] <= far_m && i != before) {
                double left = separate_pair(kernel, (size_t)i, larger(group->far_m, least));
                if (left < least) {
                    least = left;
                    kernel->state.nearest = i;
                }
            }
            if (kernel->clear_m[i] < near_m)
                kernel->near[count++] = i;
            clear_m = smaller(clear_m, kernel->clear_m[i]);
        }
        group->clear_m = clear_m;
    }
    note_nearest(kernel, least);
    return count;
}

void kernel_separate(Kernel *kernel, const double *q, double far_m)
{
    travel(kernel, q);
    for (size_t i = 0; i < kernel->group_count; i++)
        kernel->groups[i].far_m = far_m;
    look(kernel);
}

static double swept(const Kernel *kernel, const double *sweep, const double *v)
{
    double sum = 0.0;
    for (int i = 0; i < kernel->n; i++)
        sum += sweep[i] * fabs(v[i]);
    return sum;
}

static double closing(const Kernel *kernel, size_t pair, const double *v)
{
    return swept(kernel, kernel->pairs[pair].sweep, v);
}

static double fastest_closing(const Kernel *kernel, const double *v)
{
    return swept(kernel, kernel->farthest, v);
}

/* How far apart a pair is kept: only the first, which moves less, may be a body that others move. */
static double kept_m(const Kernel *kernel, size_t pair)
{
    return kernel->pairs[pair].safety_m + kernel->grown_m[kernel->pairs[pair].first];
}

/* How fast the distance of a pair grows per joint speed: the nearest points of both bodies lie on
 * the normal, so one moment serves both. */
static void gradient(const Kernel *kernel, size_t pair, double *row)
{
    const Separation *found = &kernel->separations[pair];
    int low = kernel->shapes[kernel->pairs[pair].first].body;
    int high = kernel->shapes[kernel->pairs[pair].second].body;
    for (int i = 0; i < kernel->n; i++) {
        row[i] = 0.0;
        if (i < low || i >= high)
            continue;
        if (kernel->chain.prismatic[i]) {
            row[i] = dot3(found->normal, kernel->pose.axes[i]);
        } else {
            double arm[3], lever[3];
            subtract3(found->point, kernel->pose.origins[i], arm);
            cross3(kernel->pose.axes[i], arm, lever);
            row[i] = dot3(found->normal, lever);
        }
    }
}

/* How long the joint that needs longest takes to stop. */
static double stopping_time(const Kernel *kernel)
{
    double longest_s = 0.0;
    for (int i = 0; i < kernel->n; i++)
        longest_s = larger(longest_s, fabs(kernel->state.v[i]) / kernel->acceleration[i]);
    return longest_s;
}

/* JointBounds.fill */
static void fill_bounds(Kernel *kernel, double dt_s)
{
    Program *program = &kernel->program;
    kernel->ending = false;
    double longest_s = stopping_time(kernel);
    for (int i = 0; i < kernel->n; i++) {
        double position = kernel->state.q[i], speed = kernel->state.v[i];
        double fastest = kernel->velocity[i], acceleration = kernel->acceleration[i];
        double gain = acceleration * dt_s, slowed = speed - gain, sped = speed + gain;
        double top = smaller(fastest, sped), bottom = larger(-fastest, slowed);
        double room = kernel->upper[i] - position;
        if (room > 0.0 && top * longest_s > 2.0 * room) {
            top = 2.0 * room / longest_s;
            kernel->ending = true;
        }
        if (room * acceleration < fastest * (fastest + gain)) {
            double stop = stopping_speed(room, acceleration, dt_s);
            if (top > stop) {
                top = stop;
                kernel->ending = true;
            }
        }
        room = position - kernel->lower[i];
        if (room > 0.0 && bottom * longest_s < -2.0 * room) {
            bottom = -2.0 * room / longest_s;
            kernel->ending = true;
        }
        if (room * acceleration < fastest * (fastest + gain)) {
            double stop = -stopping_speed(room, acceleration, dt_s);
            if (bottom < stop) {
                bottom = stop;
                kernel->ending = true;
            }
        }
        /* Braking harder than the joint can is impossible. */
        program->highest[i] = larger(top, slowed);
        program->lowest[i] = smaller(bottom, sped);
    }
}

/* How fast a pair may close in: negative. */
static double least_of(const Kernel *kernel, size_t pair, double dt_s)
{
    return -stopping_speed(kernel->separations[pair].distance_m - kept_m(kernel, pair),
                           kernel->pairs[pair].deceleration_m_s2, dt_s);
}

/* Below which of what is left of its distance a pair that can close in at `speed` needs a row. */
static double needs_row_m(const PairGroup *group, double speed, double dt_s)
{
    speed += TIGHT_M_S;
    return group->safety_m + speed * (speed / (2.0 * group->deceleration_m_s2) + dt_s);
}

/* How near the pairs of each group matter: where speeds within the joints' bounds could bring them
 * too near. No point of a ball is faster than its middle at the middle of these bounds, and what
 * each joint adds by half their width. */
static void find_far(Kernel *kernel, double dt_s)
{
    const Program *program = &kernel->program;
    double middle[3], from[3], lever[3];
    for (int high = 1; high <= kernel->n; high++) {
        double radius_m = kernel->balls[high].radius_m, more = 0.0;
        double linear[3] = {0.0, 0.0, 0.0}, angular[3] = {0.0, 0.0, 0.0};
        ball_middle(kernel, high, middle);
        for (int low = high - 1; low >= 0; low--) {
            const double *axis = kernel->pose.axes[low];
            double mean = 0.5 * (program->highest[low] + program->lowest[low]);
            double half = 0.5 * (program->highest[low] - program->lowest[low]);
            if (kernel->chain.prismatic[low]) {
                along3(linear, mean, axis, linear);
                more += half;
            } else {
                subtract3(middle, kernel->pose.origins[low], from);
                cross3(axis, from, lever);
                along3(linear, mean, lever, linear);
                along3(angular, mean, axis, angular);
                more += half * (norm3(lever) + radius_m);
            }
            int32_t number = kernel->group_of[low][high];
            if (number < 0)
                continue;
            PairGroup *group = &kernel->groups[number];
            double speed = norm3(linear) + norm3(angular) * radius_m + more;
            group->far_m = needs_row_m(group, speed, dt_s);
        }
    }
}

/* Of `near` those that speeds within the joints' bounds can bring too near, MAX_ROWS at most: those
 * that can be farthest beyond what they may. Returns how many; they are the first. */
static int keep_those_that_bind(Kernel *kernel, int count, double dt_s)
{
    const Program *program = &kernel->program;
    int kept = 0;
    for (int i = 0; i < count; i++) {
        double row[MAX_JOINTS];
        size_t pair = (size_t)kernel->near[i];
        double room = -least_of(kernel, pair, dt_s);
        gradient(kernel, pair, row);
        for (int j = 0; j < kernel->n; j++)
            room += row[j] * (row[j] > 0.0 ? program->lowest[j] : program->highest[j]);
        if (room < TIGHT_M_S) {
            kernel->near[kept] = kernel->near[i];
            kernel->room[kept++] = room;
        }
    }
    /* By number, as in Python: how the motion slides depends on their order. */
    for (int i = 1; i < kept && kept <= MAX_ROWS; i++) {
        int32_t pair = kernel->near[i];
        int at = i;
        for (; at > 0 && kernel->near[at - 1] > pair; at--)
            kernel->near[at] = kernel->near[at - 1];
        kernel->near[at] = pair;
    }
    for (int i = 0; i < MAX_ROWS && kept > MAX_ROWS; i++) {
        int least = i;
        for (int j = i + 1; j < kept; j++)
            if (kernel->room[j] < kernel->room[least])
                least = j;
        double room = kernel->room[i];
        int32_t pair = kernel->near[i];
        kernel->room[i] = kernel->room[least];
        kernel->near[i] = kernel->near[least];
        kernel->room[least] = room;
        kernel->near[least] = pair;
    }
    return kept < MAX_ROWS ? kept : MAX_ROWS;
}

/* A row of the program for each pair of bodies that could meet within the joints' bounds, which
 * are filled in. */
static void add_rows(Kernel *kernel, double dt_s)
{
    KernelState *state = &kernel->state;
    Program *program = &kernel->program;
    state->active = program->rows = 0;
    if (!kernel->pair_count)
        return;
    travel(kernel, state->q);
    find_far(kernel, dt_s);
    int count = keep_those_that_bind(kernel, look(kernel), dt_s);
    for (int r = 0; r < count; r++) {
        size_t pair = (size_t)kernel->near[r];
        gradient(kernel, pair, program->row[r]);
        for (int i = kernel->n; i < kernel->n + MAX_PARTS; i++)
            program->row[r][i] = 0.0;
        program->row_name[r] = (int)pair;
        program->least[r] = least_of(kernel, pair, dt_s);
    }
    state->active = program->rows = count;
}

/* ----------------------------------------------------------------------------------------------
 * The program */

/* The program's solution in its x; a braking ramp where there is none. */
static void solve_program(Kernel *kernel)
{
    Program *program = &kernel->program;
    KernelState *state = &kernel->state;
    int failed = program_solve(program);
    state->iterations += program->iterations;
    if (failed || !all_finite(program->x, program->unknowns)) {
        state->failures++;
        state->problem = KERNEL_NO_SOLUTION;
        for (int i = 0; i < program->unknowns; i++)
            program->x[i] = smaller(larger(0.0, program->lowest[i]), program->highest[i]);
    }
}

static void solve(Kernel *kernel)
{
    kernel->program.unknowns = kernel->n + 1;
    solve_program(kernel);
}

/* Price of slowing along the path: the less, the nearer the TCP is to leaving its line. */
static double path_stiffness(const Kernel *kernel)
{
    const KernelState *state = &kernel->state;
    double off = larger(state->error_m / OFF_LINE_M, state->error_rad / OFF_LINE_RAD);
    double left = larger(0.0, 1.0 - off);
    return kernel->options.path_stiffness * larger(left * left, LEAST_STIFFNESS);
}

/* Bounds and price of the speed along the path: a share of the pace, alike at any pace. */
static void price_slowing(Kernel *kernel, double pace, double stiffness)
{
    Program *program = &kernel->program;
    int n = kernel->n;
    if (!(pace > AT_REST)) {
        program->hessian[n][n] = 1.0;
        program->highest[n] = program->lowest[n] = 0.0;
        return;
    }
    program->hessian[n][n] += stiffness;
    program->linear[n] -= stiffness * pace;
    program->highest[n] = pace;
    program->lowest[n] = kernel->state.reach ? pace : 0.0;
}

/* ----------------------------------------------------------------------------------------------
 * What is asked */

/* x from L L' x = b, where `matrix` (positive definite) becomes L. */
static void cholesky_solve(int n, double matrix[MAX_JOINTS][MAX_JOINTS], double *b, bool factored)
{
    for (int i = 0; i < n && !factored; i++) {
        for (int j = 0; j < i; j++)
            matrix[i][j] = (matrix[i][j] - product(j, matrix[i], matrix[j])) / matrix[j][j];
        matrix[i][i] = sqrt(matrix[i][i] - product(i, matrix[i], matrix[i]));
    }
    for (int i = 0; i < n; i++)
        b[i] = (b[i] - product(i, matrix[i], b)) / matrix[i][i];
    for (int i = n - 1; i >= 0; i--) {
        double sum = b[i];
        for (int j = i + 1; j < n; j++)
            sum -= matrix[j][i] * b[j];
        b[i] = sum / matrix[i][i];
    }
}

/* out = J' W^2 J with the given weights, both triangles. */
static void normal_matrix(const Kernel *kernel, const double *weights,
                          double out[MAX_JOINTS][MAX_JOINTS])
{
    for (int i = 0; i < kernel->n; i++)
        for (int j = 0; j <= i; j++) {
            double sum = 0.0;
            for (int row = 0; row < 6; row++)
                sum += (weights[row] * kernel->jacobian[row][i]) *
                       (weights[row] * kernel->jacobian[row][j]);
            out[i][j] = out[j][i] = sum;
        }
}

/* Drop what an arm with few joints cannot do from what is asked, and keep its size. */
static void project(Kernel *kernel, double wanted[6], double feedback[6])
{
    int n = kernel->n;
    double matrix[MAX_JOINTS][MAX_JOINTS], rest[6];
    normal_matrix(kernel, kernel->weights, matrix);
    for (int i = 0; i < n; i++)
        matrix[i][i] += FREE_DIRECTION;
    memcpy(rest, wanted, sizeof rest);
    for (int part = 0; part < 2; part++) {
        double *asked = part ? feedback : wanted, speeds[MAX_JOINTS];
        for (int i = 0; i < n; i++) {
            speeds[i] = 0.0;
            for (int row = 0; row < 6; row++)
                speeds[i] += kernel->weights[row] * kernel->weights[row] *
                             kernel->jacobian[row][i] * asked[row];
        }
        cholesky_solve(n, matrix, speeds, part == 1);
        for (int row = 0; row < 6; row++)
            asked[row] = product(n, kernel->jacobian[row], speeds);
    }
    for (int row = 0; row < 6; row++)
        rest[row] -= wanted[row];
    kernel->state.unreachable_m_s = norm3(rest);
    kernel->state.unreachable_rad_s = norm3(rest + 3);
}

/* The velocity that removes the pose error in `feedback` and can still stop. */
static void limit_feedback(Kernel *kernel, double feedback[6], double dt_s)
{
    const KernelOptions *options = &kernel->options;
    double error_m = kernel->state.error_m = norm3(feedback);
    double error_rad = kernel->state.error_rad = norm3(feedback + 3);
    if (error_m < kernel->small_m && error_rad < kernel->small_rad) {
        for (int i = 0; i < 6; i++)
            feedback[i] *= options->gain_1_s;
        return;
    }
    for (int part = 0; part < 2; part++) {
        double error = part ? error_rad : error_m;
        if (!(error > 0.0))
            continue;
        double fastest = part ? options->angular_speed_rad_s : options->linear_speed_m_s;
        double deceleration =
            part ? options->angular_deceleration_rad_s2 : options->linear_deceleration_m_s2;
        double speed = smaller(smaller(options->gain_1_s * error,
                                 stopping_speed(error, deceleration, dt_s)),
                            fastest);
        for (int i = 3 * part; i < 3 * part + 3; i++)
            feedback[i] *= speed / error;
    }
}

/* Pull towards the posture, and what is asked of joints, where the task leaves freedom: along the
 * null space, and only while the TCP is asked to move. */
static void add_posture(Kernel *kernel, double vectors[MAX_JOINTS][MAX_JOINTS],
                        const double *joint_rate, double pace)
{
    Program *program = &kernel->program;
    const KernelOptions *options = &kernel->options;
    const KernelState *state = &kernel->state;
    int n = kernel->n;
    double share = smaller(1.0, pace / POSTURE_FULL_AT_M_S), pull[MAX_JOINTS];
    double weight = options->posture_weight * share * share;
    for (int i = 0; i < n; i++) {
        pull[i] = joint_rate ? joint_rate[i] : 0.0;
        if (!state->has_posture)
            continue;
        double away = state->posture[i] - state->q[i], half_turns = away / M_PI;
        if (!isfinite(kernel->lower[i])) /* the turns that it counts are no way back */
            away *= larger(0.0, 1.0 - half_turns * half_turns);
        pull[i] += share * options->posture_gain_1_s * away;
    }
    for (int k = 0; k < kernel->smallest; k++) {
        double along = 0.0;
        for (int i = 0; i < n; i++)
            along += vectors[i][k] * pull[i];
        for (int i = 0; i < n; i++) {
            for (int j = 0; j <= i; j++)
                program->hessian[i][j] += weight * vectors[i][k] * vectors[j][k];
            program->linear[i] -= weight * vectors[i][k] * along;
        }
    }
}

/* The smallest eigenvalue of the task that is not 0 for want of joints or of directions: of all
 * joints, or of those that are not at an end of their range. */
static double smallest_eigenvalue(const Kernel *kernel, bool of_free)
{
    const KernelState *state = &kernel->state;
    double columns[MAX_JOINTS][6], matrix[MAX_JOINTS][MAX_JOINTS];
    int counted = kernel->counted, free = 0;
    for (int i = 0; i < kernel->n; i++) {
        double room = smaller(kernel->upper[i] - state->q[i], state->q[i] - kernel->lower[i]);
        if (of_free && room < AT_END)
            continue;
        for (int k = 0; k < counted; k++) {
            int row = kernel->directions[k];
            columns[free][k] = kernel->scales[row] * kernel->jacobian[row][i];
        }
        free++;
    }
    if (!free)
        return 0.0;
    if (free <= counted) {
        for (int i = 0; i < free; i++)
            for (int j = 0; j <= i; j++)
                matrix[i][j] = matrix[j][i] = product(counted, columns[i], columns[j]);
        return eigen_smallest(free, matrix);
    }
    memset(matrix, 0, sizeof matrix);
    for (int i = 0; i < free; i++)
        for (int k = 0; k < counted; k++)
            for (int l = 0; l <= k; l++)
                matrix[k][l] += columns[i][k] * columns[i][l];
    for (int k = 0; k < counted; k++)
        for (int l = 0; l < k; l++)
            matrix[l][k] = matrix[k][l];
    return eigen_smallest(counted, matrix);
}

/* Smallest singular value of the task, the damping it asks for, and the directions it leaves. */
static void damp(Kernel *kernel, const double *joint_rate, double pace)
{
    Program *program = &kernel->program;
    const KernelOptions *options = &kernel->options;
    KernelState *state = &kernel->state;
    int n = kernel->n;
    double sigma = state->smallest_singular_value = sqrt(smallest_eigenvalue(kernel, kernel->held));
    double damping = options->damping_floor;
    if (sigma < options->singular_below) {
        double share = sigma / options->singular_below;
        damping += options->damping * options->damping * (1.0 - share * share);
    }
    state->damping = sqrt(damping);
    if (kernel->smallest && (state->has_posture || joint_rate)) {
        double matrix[MAX_JOINTS][MAX_JOINTS], values[MAX_JOINTS], vectors[MAX_JOINTS][MAX_JOINTS];
        normal_matrix(kernel, kernel->scales, matrix);
        if (eigen_symmetric(n, matrix, values, vectors))
            add_posture(kernel, vectors, joint_rate, pace);
    }
    for (int i = 0; i <= n; i++)
        program->hessian[i][i] += damping;
}

/* Row `index` of H and f, of its column of the task. */
static void set_row(Kernel *kernel, int index)
{
    Program *program = &kernel->program;
    for (int j = 0; j <= index; j++)
        program->hessian[index][j] = product(6, kernel->task[index], kernel->task[j]);
    program->linear[index] = -product(6, kernel->task[index], kernel->back);
}

static double weighed_size(const Kernel *kernel, const double twist[6])
{
    double square = 0.0;
    for (int row = 0; row < 6; row++)
        square += (twist[row] * kernel->weights[row]) * (twist[row] * kernel->weights[row]);
    return sqrt(square);
}

/* Unknown `index` is the speed along `twist`; its pace. It is the speed itself and not the share s,
 * so that the program is as well conditioned at 1 um/s as at 1 m/s. */
static double set_path(Kernel *kernel, int index, const double twist[6])
{
    double pace = weighed_size(kernel, twist), share = pace > AT_REST ? -1.0 / pace : 0.0;
    for (int row = 0; row < 6; row++)
        kernel->task[index][row] = twist[row] * kernel->weights[row] * share;
    set_row(kernel, index);
    return pace;
}

/* H and f of the task; the pace that is asked. */
static double set_task(Kernel *kernel, const double wanted[6], const double feedback[6])
{
    int n = kernel->n;
    for (int row = 0; row < 6; row++) {
        kernel->back[row] = feedback[row] * kernel->weights[row];
        for (int i = 0; i < n; i++)
            kernel->task[i][row] = kernel->jacobian[row][i] * kernel->weights[row];
    }
    for (int i = 0; i < n; i++)
        set_row(kernel, i);
    return set_path(kernel, n, wanted);
}

/* ----------------------------------------------------------------------------------------------
 * Sliding */

/* The rows of pairs of bodies that close as fast as they may, and how many they are. */
static int find_tight(const Kernel *kernel, int tight[MAX_ROWS])
{
    const Program *program = &kernel->program;
    int count = 0;
    for (int r = 0; r < program->rows; r++)
        if (product(kernel->n, program->row[r], program->x) - program->least[r] < TIGHT_M_S)
            tight[count++] = r;
    return count;
}

/* What is left of the translation `along` by the pairs of bodies that are tight. */
static void leave_along(const Kernel *kernel, const int *tight, int count, double along[3])
{
    int n = kernel->n;
    double matrix[MAX_JOINTS][MAX_JOINTS], normal[MAX_ROWS][3];
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++)
            matrix[i][j] = kernel->program.hessian[i][j];
    for (int t = 0; t < count; t++) {
        /* How the pair's distance grows with the translation of the TCP. */
        double lever[MAX_JOINTS];
        memcpy(lever, kernel->program.row[tight[t]], (size_t)n * sizeof *lever);
        cholesky_solve(n, matrix, lever, t > 0);
        for (int row = 0; row < 3; row++)
            normal[t][row] = kernel->weights[row] * kernel->weights[row] *
                             product(n, kernel->jacobian[row], lever);
    }
    for (int sweep = 0; sweep < SWEEPS; sweep++)
        for (int t = 0; t < count; t++) {
            double closing_speed = dot3(normal[t], along), size = dot3(normal[t], normal[t]);
            if (closing_speed < 0.0 && size > FREE_DIRECTION)
                along3(along, -closing_speed / size, normal[t], along);
        }
}

/* What is asked in parts of which one may be given up without the others: translation along what is
 * in the way, translation into it, rotation; without those that are none. How many they are. */
static int find_parts(const Kernel *kernel, const double wanted[6], const int *tight, int count,
                      double parts[MAX_PARTS][6])
{
    memset(parts, 0, MAX_PARTS * sizeof *parts);
    copy3(wanted, parts[0]);
    copy3(wanted + 3, parts[2] + 3);
    if (count)
        leave_along(kernel, tight, count, parts[0]);
    subtract3(wanted, parts[0], parts[1]);
    int found = 0;
    for (int part = 0; part < MAX_PARTS; part++) {
        if (!(weighed_size(kernel, parts[part]) > AT_REST))
            continue;
        if (found < part)
            memcpy(parts[found], parts[part], sizeof *parts);
        found++;
    }
    return found;
}

/* The program's solution with a path speed for each of `parts`, of which what is left is put in
 * place of what is asked; the share that is left. */
static double slide(Kernel *kernel, double parts[MAX_PARTS][6], int count, double stiffness,
                    double wanted[6])
{
    Program *program = &kernel->program;
    int n = kernel->n;
    double pace[MAX_PARTS], damping = kernel->state.damping * kernel->state.damping;
    for (int part = 0; part < count; part++) {
        int index = n + part;
        pace[part] = set_path(kernel, index, parts[part]);
        program->hessian[index][index] += damping + stiffness;
        program->linear[index] -= stiffness * pace[part];
        program->lowest[index] = 0.0;
        program->highest[index] = pace[part];
    }
    program->unknowns = n + count;
    solve_program(kernel);
    memset(wanted, 0, 6 * sizeof *wanted);
    for (int part = 0; part < count; part++)
        for (int row = 0; row < 6; row++)
            wanted[row] += program->x[n + part] / pace[part] * parts[part][row];
    return smaller(product(count, program->x + n, pace) / product(count, pace, pace), 1.0);
}

/* ----------------------------------------------------------------------------------------------
 * The step */

/* Whether this step would bring a pair into contact. Pairs that cannot meet within the step are
 * excluded by how far their bodies can move; so nothing is missed between two ticks. */
static bool strikes(Kernel *kernel, const double *step)
{
    bool stepped = false;
    for (size_t k = 0; k < kernel->pair_count; k++) {
        size_t i = (size_t)kernel->order[k];
        const PairGroup *group = &kernel->groups[kernel->group[i]];
        double far_m = group->travel_m + swept(kernel, group->sweep, step);
        if (group->clear_m > far_m) {
            k = group->beyond - 1;
            continue;
        }
        if (kernel->clear_m[i] > far_m)
            continue;
        double nearer = closing(kernel, i, step);
        separate_pair(kernel, i, nearer);
        double before = kernel->separations[i].distance_m;
        if (!(before >= 0.0) || !(nearer > before))
            continue;
        if (!stepped) {
            double there[MAX_JOINTS];
            ChainPose pose;
            pose.bodies[0] = kernel->pose.bodies[0];
            for (int j = 0; j < kernel->n; j++)
                there[j] = kernel->state.q[j] + step[j];
            chain_update(&kernel->chain, there, &pose);
            for (size_t j = 0; j < kernel->shape_count; j++)
                if (kernel->shapes[j].body > 0)
                    body_place(&kernel->shapes[j], &pose.bodies[kernel->shapes[j].body],
                               &kernel->ahead[j]);
            stepped = true;
        }
        Separation after = {.features = kernel->separations[i].features};
        body_separation(&kernel->ahead[kernel->pairs[i].first],
                        &kernel->ahead[kernel->pairs[i].second], 0.0, &after);
        if (after.distance_m < 0.0)
            return true;
    }
    return false;
}

static void note_motion(Kernel *kernel)
{
    KernelState *state = &kernel->state;
    double fastest = 0.0;
    for (int i = 0; i < kernel->n; i++)
        fastest = larger(fastest, fabs(state->v[i]));
    state->moving = fastest > AT_REST;
}

static void step_on(Kernel *kernel, double dt_s)
{
    KernelState *state = &kernel->state;
    Program *program = &kernel->program;
    double *v = program->x, step[MAX_JOINTS] = {0.0};
    int n = kernel->n;
    for (int i = 0; i < n; i++)
        step[i] = v[i] * dt_s;
    if (kernel->pair_count && fastest_closing(kernel, step) > kernel->nearest_m &&
        strikes(kernel, step)) {
        /* The soft rows are violated; what is left is to be slower. */
        state->failures++;
        for (int i = 0; i < n; i++) {
            v[i] = smaller(larger(0.0, program->lowest[i]), program->highest[i]);
            step[i] = v[i] * dt_s;
        }
    }
    for (int i = 0; i < n; i++) {
        state->v[i] = v[i];
        state->q[i] += step[i];
    }
    note_motion(kernel);
    if (state->iterations > state->most_iterations)
        state->most_iterations = state->iterations;
}

static void update(Kernel *kernel)
{
    chain_update(&kernel->chain, kernel->state.q, &kernel->pose);
    chain_jacobian(&kernel->chain, &kernel->pose, kernel->jacobian);
}

static bool period_is_sound(Kernel *kernel, double dt_s)
{
    kernel->state.problem = KERNEL_GOOD;
    kernel->state.iterations = 0;
    if (dt_s > 0.0 && dt_s <= LONGEST_PERIOD_S)
        return true;
    kernel->state.problem = KERNEL_BAD_PERIOD;
    kernel->state.path_speed = 0.0;
    memset(kernel->state.twist, 0, sizeof kernel->state.twist);
    return false;
}

/* Slow every joint down as fast as it can, obstacles in the braking path included. */
static void brake(Kernel *kernel, double dt_s)
{
    Program *program = &kernel->program;
    KernelState *state = &kernel->state;
    int n = kernel->n;
    update(kernel);
    memset(program->hessian, 0, sizeof program->hessian);
    memset(program->linear, 0, sizeof program->linear);
    for (int i = 0; i <= n; i++)
        program->hessian[i][i] = 1.0;
    program->lowest[n] = program->highest[n] = 0.0;
    fill_bounds(kernel, dt_s);
    add_rows(kernel, dt_s);
    solve(kernel);
    state->path_speed = 0.0;
    kernel->held = false;
    memset(state->twist, 0, sizeof state->twist);
    step_on(kernel, dt_s);
}

static double refuse(Kernel *kernel, double dt_s)
{
    kernel->state.failures++;
    brake(kernel, dt_s);
    kernel->state.problem = KERNEL_BAD_INPUT;
    return 0.0;
}

static void turn_both(const double rotation[9], const double twist[6], double out[6])
{
    turn3(rotation, twist, out);
    turn3(rotation, twist + 3, out + 3);
}

double kernel_tick(Kernel *kernel, double dt_s, int32_t flags)
{
    KernelState *state = &kernel->state;
    Program *program = &kernel->program;
    int n = kernel->n;
    const double *joint_rate = flags & KERNEL_WITH_RATE ? state->joint_rate : NULL;
    if (!period_is_sound(kernel, dt_s))
        return 0.0;
    double length = product(4, state->goal_orientation, state->goal_orientation);
    if (!all_finite(state->goal_position, 3) || !(length > 1e-6 && length < 1e6) ||
        !all_finite(state->goal_twist, 6) || (joint_rate && !all_finite(joint_rate, n)) ||
        (state->has_posture && !all_finite(state->posture, n)))
        return refuse(kernel, dt_s);

    update(kernel);
    const Placement *tcp = &kernel->pose.tcp;
    double goal[9], away[3], apart[9], feedback[6], wanted[6];
    quaternion_to_rotation(state->goal_orientation, goal);
    subtract3(state->goal_position, tcp->position, away);
    turn_back3(tcp->rotation, away, feedback);
    for (int row = 0; row < 3; row++)
        for (int column = 0; column < 3; column++) {
            apart[3 * row + column] = tcp->rotation[row] * goal[column] +
                                      tcp->rotation[3 + row] * goal[3 + column] +
                                      tcp->rotation[6 + row] * goal[6 + column];
        }
    rotation_log(apart, feedback + 3);
    turn_back3(tcp->rotation, state->goal_twist, wanted);
    turn_back3(tcp->rotation, state->goal_twist + 3, wanted + 3);
    if (joint_rate)
        for (int row = 0; row < 6; row++)
            wanted[row] += product(n, kernel->jacobian[row], joint_rate);
    state->unreachable_m_s = state->unreachable_rad_s = 0.0;
    if (!kernel->full_rank) {
        double turned[9], reached[9];
        project(kernel, wanted, feedback);
        rotation_exp(feedback + 3, turned);
        multiply33(tcp->rotation, turned, reached);
        rotation_to_quaternion(reached, state->reachable_orientation);
        turn3(tcp->rotation, feedback, away);
        along3(tcp->position, 1.0, away, state->reachable_position);
    }
    limit_feedback(kernel, feedback, dt_s);

    double pace = set_task(kernel, wanted, feedback);
    damp(kernel, joint_rate, pace);
    double stiffness = path_stiffness(kernel);
    price_slowing(kernel, pace, stiffness);
    fill_bounds(kernel, dt_s);
    add_rows(kernel, dt_s);
    solve(kernel);
    double share = pace > AT_REST ? smaller(program->x[n] / pace, 1.0) : 1.0;
    int tight[MAX_ROWS], blocked = flags & KERNEL_SLIDE ? find_tight(kernel, tight) : 0;
    double parts[MAX_PARTS][6];
    int count = 1;
    if (flags & KERNEL_SLIDE && !(state->reach && blocked) &&
        ((kernel->ending && share < SLOWED) || blocked))
        count = find_parts(kernel, wanted, tight, blocked, parts);
    if (state->reach && blocked) {
        /* The goal must not run away from the arm. */
        double asked = product(6, wanted, wanted), left[6];
        for (int row = 0; row < 6; row++)
            left[row] = product(n, kernel->jacobian[row], program->x) - feedback[row];
        share = asked > 0.0 ? smaller(larger(product(6, left, wanted) / asked, 0.0), 1.0) : 1.0;
        memcpy(wanted, left, sizeof wanted);
    } else if (count > 1) {
        share = slide(kernel, parts, count, stiffness, wanted);
    } else {
        for (int row = 0; row < 6; row++)
            wanted[row] *= share;
    }
    kernel->held = kernel->ending && share < SLOWED;
    state->path_speed = share;
    turn_both(tcp->rotation, wanted, state->twist);
    step_on(kernel, dt_s);
    return share;
}

double kernel_tick_joints(Kernel *kernel, double dt_s)
{
    KernelState *state = &kernel->state;
    Program *program = &kernel->program;
    int n = kernel->n;
    const double *goal = state->goal_joints, *rate = state->goal_rate;
    if (!period_is_sound(kernel, dt_s))
        return 0.0;
    if (!all_finite(goal, n) || !all_finite(rate, n))
        return refuse(kernel, dt_s);
    update(kernel);
    double pace = sqrt(product(n, rate, rate)), along = 0.0;
    memset(program->hessian, 0, sizeof program->hessian);
    for (int i = 0; i < n; i++) {
        double error = goal[i] - state->q[i], size = fabs(error);
        double speed = smaller(kernel->options.joint_gain_1_s * size,
                            stopping_speed(size, kernel->acceleration[i], dt_s));
        program->linear[i] = -copysign(speed, error);
        program->hessian[i][i] = 1.0;
        program->hessian[n][i] = pace > AT_REST ? rate[i] / -pace : 0.0;
        along -= rate[i] * program->linear[i];
    }
    program->hessian[n][n] = 1.0;
    program->linear[n] = pace > AT_REST ? along / pace : 0.0;
    price_slowing(kernel, pace, kernel->options.path_stiffness);
    fill_bounds(kernel, dt_s);
    add_rows(kernel, dt_s);
    solve(kernel);
    double share = pace > AT_REST ? smaller(program->x[n] / pace, 1.0) : 1.0;
    state->path_speed = share;
    kernel->held = kernel->ending && share < SLOWED;
    state->error_m = state->error_rad = 0.0;
    step_on(kernel, dt_s);
    return share;
}

void kernel_brake(Kernel *kernel, double dt_s)
{
    if (period_is_sound(kernel, dt_s))
        brake(kernel, dt_s);
}

/* ----------------------------------------------------------------------------------------------
 * State */

int32_t kernel_place(Kernel *kernel, const double *q)
{
    KernelState *state = &kernel->state;
    if (!all_within(q, (size_t)kernel->n, -LARGEST, LARGEST))
        return false;
    for (int i = 0; i < kernel->n; i++) {
        state->q[i] = q[i];
        state->v[i] = 0.0;
    }
    state->moving = false;
    state->path_speed = 1.0;
    state->error_m = state->error_rad = 0.0;
    state->active = 0;
    kernel->held = false;
    program_forget(&kernel->program);
    update(kernel);
    forget_distances(kernel); /* What is known is so for motion within the limits only. */
    kernel_separate(kernel, q, 0.0);
    return true;
}

int32_t kernel_move_at(Kernel *kernel, const double *v)
{
    if (!all_within(v, (size_t)kernel->n, -LARGEST, LARGEST))
        return false;
    memcpy(kernel->state.v, v, (size_t)kernel->n * sizeof *v);
    note_motion(kernel);
    return true;
}

static void fill_pose(Kernel *kernel, const double *q)
{
    ChainPose pose;
    pose.bodies[0] = kernel->pose.bodies[0];
    chain_update(&kernel->chain, q, &pose);
    copy3(pose.tcp.position, kernel->state.pose_position);
    rotation_to_quaternion(pose.tcp.rotation, kernel->state.pose_orientation);
}

void kernel_pose(Kernel *kernel)
{
    fill_pose(kernel, kernel->state.q);
}

void kernel_pose_at(Kernel *kernel)
{
    fill_pose(kernel, kernel->state.pose_joints);
}

void kernel_motion(Kernel *kernel)
{
    double own[6];
    for (int row = 0; row < 6; row++)
        own[row] = product(kernel->n, kernel->jacobian[row], kernel->state.v);
    turn_both(kernel->pose.tcp.rotation, own, kernel->state.motion);
}

void kernel_status(Kernel *kernel)
{
    KernelState *state = &kernel->state;
    const Program *program = &kernel->program;
    state->limiting = 0;
    if (!state->moving && !kernel->held)
        return;
    for (int i = 0; i < kernel->n; i++)
        if (state->v[i] >= program->highest[i] - LIMITING ||
            state->v[i] <= program->lowest[i] + LIMITING)
            state->limiting |= 1 << i;
}

/* ----------------------------------------------------------------------------------------------
 * Parts */

void kernel_kinematics(Kernel *kernel, const double *q, double rotation[9], double position[3],
                       double *jacobian)
{
    int n = kernel->n;
    chain_update(&kernel->chain, q, &kernel->pose);
    chain_jacobian(&kernel->chain, &kernel->pose, kernel->jacobian);
    memcpy(rotation, kernel->pose.tcp.rotation, sizeof kernel->pose.tcp.rotation);
    copy3(kernel->pose.tcp.position, position);
    for (int row = 0; row < 6; row++)
        for (int i = 0; i < n; i++)
            jacobian[row * n + i] = kernel->jacobian[row][i];
}

void kernel_distances(Kernel *kernel, const double *q, double *distances, double *gradients)
{
    chain_update(&kernel->chain, q, &kernel->pose);
    kernel_separate(kernel, q, INFINITY);
    forget_distances(kernel);
    for (size_t i = 0; i < kernel->pair_count; i++) {
        distances[i] = kernel->separations[i].distance_m;
        gradient(kernel, i, gradients + i * (size_t)kernel->n);
    }
}

int32_t kernel_program(Program *program)
{
    return program_solve(program);
}

double kernel_smallest_eigenvalue(const double *matrix, int32_t n)
{
    double copy[MAX_JOINTS][MAX_JOINTS] = {{0.0}};
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++)
            copy[i][j] = matrix[i * n + j];
    return eigen_smallest(n, copy);
}
