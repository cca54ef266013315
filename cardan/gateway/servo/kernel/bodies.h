/* Distances of capsules (spheres too), boxes and half-spaces, with sign and nearest points. */
#ifndef CARDAN_SERVO_BODIES_H
#define CARDAN_SERVO_BODIES_H

#include <stdint.h>

#include "chain.h"

enum { SHAPE_CAPSULE, SHAPE_BOX, SHAPE_HALF_SPACE };

/* Fixed to a body, in its frame. Which fields count depends on the kind. */
typedef struct {
    int32_t kind;
    int32_t body;
    double start[3], end[3]; /* of the segment of a capsule; the same point twice: a sphere */
    double radius_m;
    double rotation[9], position[3]; /* of the middle of a box */
    double half_m[3];                /* half the edges of a box */
    double normal[3];                /* of a half-space, out of the solid; only of body 0 */
    double offset_m;
} KernelShape;

/* A shape where its body is. */
typedef struct {
    int kind;
    double start[3], end[3], radius_m; /* capsule */
    double rotation[9], position[3];   /* box */
    double half_m[3];
    double normal[3], offset_m; /* half-space */
    double middle[3], around_m; /* of a ball around a capsule or a box */
} Body;

typedef struct {
    double distance_m; /* negative: they overlap by so much */
    double normal[3];  /* unit vector from the first to the second */
    double point[3];   /* of the second that is nearest to the first, or deepest in it */
    int32_t features;  /* of two boxes: those that were nearest when last computed; 0: none */
} Separation;

void body_place(const KernelShape *shape, const Placement *at, Body *body);

/* Not of two half-spaces. Where they are farther apart than `far_m`, out has a distance between that
 * and the true one, and nothing else: that much is found at once. What of two boxes was nearest before
 * is tried first: `features` is in and out, and 0 before the first time. */
void body_separation(const Body *first, const Body *second, double far_m, Separation *out);

#endif
