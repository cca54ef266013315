/*
 * What the servo is compared with, in the language that the others are used from: each is a plain
 * library with these four functions, loaded by bench/native. A step is timed in here, so that
 * nobody is charged for Python.
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
} PeerArm;

static inline double peer_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

#ifdef __cplusplus
extern "C" {
#endif

/* Starts at home. NULL where it cannot take the arm. */
PEER_API void *peer_create(const PeerArm *arm);
PEER_API void peer_destroy(void *peer);

/* Moves its joints for `dt` towards a TCP in the base; how long that took, s. */
PEER_API double peer_step(void *peer, const double rotation[9], const double position[3], double dt);

PEER_API void peer_joints(const void *peer, double *q);

#ifdef __cplusplus
}
#endif

#endif
