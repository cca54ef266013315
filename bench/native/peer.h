/*
 * Interface of the peers compared with the servo, in their users' language: each is a plain library
 * with these functions, loaded by bench/native; `peer_surround` and the functions after it exist
 * only in peers that compute distances. Steps are timed inside, so that Python is not counted.
 */
#ifndef BENCH_PEER_H
#define BENCH_PEER_H

#include <stdint.h>
#include <time.h>

#define PEER_JOINTS 8
#define PEER_API __attribute__((visibility("default")))

/* A serial arm. Rotations row by row; lengths in m, angles in rad. */
typedef struct {
    int32_t joints;
    int32_t prismatic[PEER_JOINTS];
    double rotation[PEER_JOINTS][9]; /* of the joint in the body before, at zero */
    double position[PEER_JOINTS][3];
    double axis[PEER_JOINTS][3];
    double tcp_rotation[9], tcp_position[3]; /* in the last body */
    double lower[PEER_JOINTS], upper[PEER_JOINTS];
    double velocity[PEER_JOINTS], acceleration[PEER_JOINTS];
    double home[PEER_JOINTS];
    double weights[6]; /* of x y z rx ry rz along TCP axes; 0 leaves a direction free */
} PeerArm;

enum { PEER_CAPSULE, PEER_SPHERE, PEER_BOX };

/* Shape fixed to a body (0: the base); a capsule lies along its z axis. */
typedef struct {
    int32_t kind, body;
    double rotation[9], position[3];
    double size[3]; /* capsule: radius and length; sphere: radius; box: edges */
} PeerShape;

/* Two shapes that are kept apart; the second one's body is farther along the arm. */
typedef struct {
    int32_t first, second;
    double safety_m, deceleration_m_s2;
    double sweep[PEER_JOINTS]; /* how much nearer they come per joint motion, at most */
} PeerPair;

static inline double peer_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

#ifdef __cplusplus
extern "C" {
#endif

/* Starts at home. Returns NULL if it does not support the arm. */
PEER_API void *peer_create(const PeerArm *arm);
PEER_API void peer_destroy(void *peer);

/* Moves the joints for `dt` towards a TCP in the base frame; returns the duration, s. */
PEER_API double peer_step(void *peer, const double rotation[9], const double position[3], double dt);

PEER_API void peer_joints(const void *peer, double *q);

/* Adds pairs that each later step keeps apart. */
PEER_API void peer_surround(void *peer, const PeerShape *shapes, int32_t shape_count,
                            const PeerPair *pairs, int32_t pair_count);

/* Distance of each pair in the last step, and number of pairs with a row in its program. */
PEER_API void peer_distances(const void *peer, double *distances);
PEER_API int32_t peer_rows(const void *peer);

#ifdef __cplusplus
}
#endif

#endif
