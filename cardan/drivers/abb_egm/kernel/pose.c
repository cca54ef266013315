#include "pose.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

/* As in limiters.py, which says why. */
#define TINY 1e-12

static const double ZERO[3] = {0.0, 0.0, 0.0};

static double dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static bool same(const double *a, const double *b, int count)
{
    for (int i = 0; i < count; i++)
        if (!(a[i] == b[i]))
            return false;
    return true;
}

static void shortened(const double *v, double longest, double *into)
{
    double length = sqrt(dot(v, v)), shrink = length > longest ? longest / length : 1.0;
    for (int i = 0; i < 3; i++)
        into[i] = v[i] * shrink;
}

static void clip(const double *v, const double *lowest, const double *highest, double *into)
{
    for (int i = 0; i < 3; i++) {
        double value = lowest[i] > v[i] ? lowest[i] : v[i];
        into[i] = highest[i] < value ? highest[i] : value;
    }
}

/* _steer: the next velocity of a point that is `error` away from a target moving at `forward`. */
static void steer(const double *velocity, const double *error, const double *forward, double speed,
                  double acceleration, double dt_s, double *into)
{
    double w[3] = {forward[0], forward[1], forward[2]}, e[3], d[3];
    double squared = dot(w, w), gain = acceleration * dt_s;
    if (squared > speed * speed) {
        double shrink = speed / sqrt(squared);
        for (int i = 0; i < 3; i++)
            w[i] *= shrink;
    }
    for (int i = 0; i < 3; i++)
        e[i] = error[i] - w[i] * dt_s;
    double behind = sqrt(dot(e, e));
    if (behind > TINY) {
        double closing = (sqrt(gain * gain + 2.0 * acceleration * behind) - gain) / behind;
        for (int i = 0; i < 3; i++)
            w[i] += e[i] * closing;
        squared = dot(w, w);
        if (squared > speed * speed) {
            double shrink = speed / sqrt(squared);
            for (int i = 0; i < 3; i++)
                w[i] *= shrink;
        }
    }
    for (int i = 0; i < 3; i++)
        d[i] = w[i] - velocity[i];
    squared = dot(d, d);
    if (squared <= gain * gain) {
        memcpy(into, w, sizeof w);
        return;
    }
    double shrink = gain / sqrt(squared);
    for (int i = 0; i < 3; i++)
        into[i] = velocity[i] + d[i] * shrink;
}

static double stopping_speed(double distance, double acceleration, double dt_s)
{
    if (!(distance > 0.0))
        return 0.0;
    double gain = acceleration * dt_s;
    return sqrt(gain * gain + 2.0 * acceleration * distance) - gain;
}

/* within_walls: as much of `wanted` as the walls and the acceleration leave. */
static void confine(const EgmPoint *point, double *wanted, double dt_s)
{
    double share = point->acceleration / sqrt(3.0), gain = point->acceleration * dt_s;
    double lowest[3], highest[3], clipped[3], due[3], m[3], f[3];
    for (int i = 0; i < 3; i++) {
        lowest[i] = -stopping_speed(point->reference[i] - point->lower[i], share, dt_s);
        highest[i] = stopping_speed(point->upper[i] - point->reference[i], share, dt_s);
    }
    clip(wanted, lowest, highest, clipped);
    if (same(clipped, wanted, 3))
        return;
    clip(point->velocity, lowest, highest, due);
    for (int i = 0; i < 3; i++) {
        m[i] = due[i] - point->velocity[i];
        f[i] = clipped[i] - due[i];
    }
    double a = dot(f, f), b = dot(m, f), c = dot(m, m) - gain * gain, part = 0.0;
    if (a + 2.0 * b + c <= 0.0) {
        memcpy(wanted, clipped, sizeof clipped);
        return;
    }
    if (c < 0.0 && 0.0 < a)
        part = (sqrt(b * b - a * c) - b) / a;
    for (int i = 0; i < 3; i++)
        wanted[i] = due[i] + f[i] * part;
}

/* PointLimiter._advance */
static void advance_point(EgmPoint *point, const double *error, const double *forward, double dt_s)
{
    double velocity[3];
    steer(point->velocity, error, forward, point->speed, point->acceleration, dt_s, velocity);
    if (point->has_box)
        confine(point, velocity, dt_s);
    memcpy(point->velocity, velocity, sizeof velocity);
    for (int i = 0; i < 3; i++)
        point->reference[i] += velocity[i] * dt_s;
}

/* OrientationLimiter._advance */
static void advance_turn(EgmTurn *turn, const double *error, const double *forward, double dt_s)
{
    double v[3];
    steer(turn->velocity, error, forward, turn->speed, turn->acceleration, dt_s, v);
    memcpy(turn->velocity, v, sizeof v);
    double rate = sqrt(dot(v, v));
    if (rate < TINY)
        return;
    double half = 0.5 * rate * dt_s, factor = sin(half) / rate;
    double ax = v[0] * factor, ay = v[1] * factor, az = v[2] * factor, aw = cos(half);
    double w = turn->reference[0], x = turn->reference[1], y = turn->reference[2],
           z = turn->reference[3];
    double nw = aw * w - ax * x - ay * y - az * z;
    double nx = aw * x + ax * w + ay * z - az * y;
    double ny = aw * y - ax * z + ay * w + az * x;
    double nz = aw * z + ax * y - ay * x + az * w;
    double unit = 1.5 - 0.5 * (nw * nw + nx * nx + ny * ny + nz * nz);
    turn->reference[0] = nw * unit;
    turn->reference[1] = nx * unit;
    turn->reference[2] = ny * unit;
    turn->reference[3] = nz * unit;
}

/* PointLimiter.track */
static void track_point(EgmPoint *point, const double *position, const double *velocity,
                        double dt_s)
{
    double target[3], forward[3] = {0.0, 0.0, 0.0}, error[3];
    memcpy(target, position, sizeof target);
    if (point->has_box)
        clip(position, point->lower, point->upper, target);
    for (int i = 0; i < 3; i++) {
        if (point->has_target)
            forward[i] = (target[i] - point->target[i]) / dt_s;
        else if (velocity)
            forward[i] = velocity[i];
        error[i] = target[i] - point->reference[i];
    }
    memcpy(point->target, target, sizeof target);
    point->has_target = true;
    advance_point(point, error, forward, dt_s);
}

/* OrientationLimiter.track */
static void track_turn(EgmTurn *turn, const double *target, const double *velocity, double dt_s)
{
    double forward[3] = {0.0, 0.0, 0.0};
    double w = target[0], x = target[1], y = target[2], z = target[3];
    if (!turn->has_target) {
        if (velocity)
            memcpy(forward, velocity, sizeof forward);
    } else if (!same(turn->target, target, 4)) {
        double pw = turn->target[0], px = turn->target[1], py = turn->target[2],
               pz = turn->target[3];
        double twice = (w * pw + x * px + y * py + z * pz >= 0.0 ? 2.0 : -2.0) / dt_s;
        forward[0] = twice * (pw * x - px * w - y * pz + z * py);
        forward[1] = twice * (pw * y - py * w - z * px + x * pz);
        forward[2] = twice * (pw * z - pz * w - x * py + y * px);
    }
    memcpy(turn->target, target, sizeof turn->target);
    turn->has_target = true;
    double qw = turn->reference[0], qx = turn->reference[1], qy = turn->reference[2],
           qz = turn->reference[3];
    double dw = w * qw + x * qx + y * qy + z * qz;
    double d[3] = {
        qw * x - qx * w - y * qz + z * qy,
        qw * y - qy * w - z * qx + x * qz,
        qw * z - qz * w - x * qy + y * qx,
    };
    double sine = sqrt(dot(d, d)), factor = 2.0;
    if (sine > TINY)
        factor = 2.0 * atan2(sine, fabs(dw)) / sine;
    if (dw < 0.0)
        factor = -factor;
    for (int i = 0; i < 3; i++)
        d[i] *= factor;
    advance_turn(turn, d, forward, dt_s);
}

static bool in_range(const double *values, double largest)
{
    for (int i = 0; i < 3; i++)
        if (!(fabs(values[i]) <= largest)) /* false for NaN */
            return false;
    return true;
}

static bool is_period(double dt_s)
{
    return dt_s > 0.0 && isfinite(dt_s);
}

static bool good_pose(const EgmPoseAnswer *answer)
{
    const double *q = answer->orientation;
    double squared = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    return in_range(answer->position, answer->largest_position) &&
           answer->shortest_squared <= squared && squared <= answer->longest_squared;
}

static bool good_twist(const EgmPoseAnswer *answer)
{
    return in_range(answer->linear, answer->largest_linear) &&
           in_range(answer->angular, answer->largest_angular);
}

/* PoseReferenceGenerator._relocate */
static void relocate(EgmPoseAnswer *answer)
{
    for (int i = 0; i < 3; i++)
        answer->point.reference[i] =
            answer->measured_position[i] + answer->point.velocity[i] * answer->delay_s;
    memcpy(answer->turn.reference, answer->measured_orientation, sizeof answer->turn.reference);
}

static int32_t reply(EgmPoseAnswer *answer, uint32_t seqno, uint32_t tm_ms)
{
    const EgmPoint *point = &answer->point;
    const EgmTurn *turn = &answer->turn;
    answer->moving = !same(point->velocity, ZERO, 3) || !same(turn->velocity, ZERO, 3);
    uint8_t *at = egm_put_header(answer->reply, seqno, tm_ms);
    if (answer->says & EGM_SAYS_POSITION)
        at = egm_put_pose(at, point->reference, turn->reference);
    if (answer->says & EGM_SAYS_SPEED)
        at = egm_put_twist(at, point->velocity, turn->velocity);
    return (int32_t)(at - answer->reply);
}

int32_t egm_pose_answer(EgmPoseAnswer *answer, int32_t with_twist, double dt_s, uint32_t seqno,
                        uint32_t tm_ms)
{
    if (!is_period(dt_s) || !good_pose(answer) || (with_twist && !good_twist(answer)))
        return 0;
    track_point(&answer->point, answer->position, with_twist ? answer->linear : NULL, dt_s);
    track_turn(&answer->turn, answer->orientation, with_twist ? answer->angular : NULL, dt_s);
    return reply(answer, seqno, tm_ms);
}

int32_t egm_pose_answer_speed(EgmPoseAnswer *answer, double dt_s, uint32_t seqno, uint32_t tm_ms)
{
    double velocity[3], way[3];
    EgmPoint *point = &answer->point;
    EgmTurn *turn = &answer->turn;
    if (!is_period(dt_s) || !good_twist(answer))
        return 0;
    if (answer->relocates)
        relocate(answer);
    point->has_target = turn->has_target = false;
    shortened(answer->linear, point->speed, velocity);
    for (int i = 0; i < 3; i++)
        way[i] = velocity[i] * dt_s;
    advance_point(point, way, velocity, dt_s);
    shortened(answer->angular, turn->speed, velocity);
    for (int i = 0; i < 3; i++)
        way[i] = velocity[i] * dt_s;
    advance_turn(turn, way, velocity, dt_s);
    return reply(answer, seqno, tm_ms);
}

int32_t egm_pose_answer_hold(EgmPoseAnswer *answer, double dt_s, uint32_t seqno, uint32_t tm_ms)
{
    EgmPoint *point = &answer->point;
    EgmTurn *turn = &answer->turn;
    if (!is_period(dt_s))
        return 0;
    if (answer->relocates)
        relocate(answer);
    point->has_target = turn->has_target = false;
    if (!same(point->velocity, ZERO, 3))
        advance_point(point, ZERO, ZERO, dt_s);
    if (!same(turn->velocity, ZERO, 3))
        advance_turn(turn, ZERO, ZERO, dt_s);
    return reply(answer, seqno, tm_ms);
}
