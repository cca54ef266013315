/* The forces of fixtures, world frame. `last` is the direction a fixture pushed along before, for
 * positions where its geometry gives none. */
#ifndef CARDAN_OMNI_FIXTURES_H
#define CARDAN_OMNI_FIXTURES_H

#include "tick.h"

/* Adds the force of `f` on `point` to `force` and updates `last`. */
void push_fixture(double force[3], const TickFixture *f, const double point[3],
                  const double velocity[3], double last[3]);

/* An initial `last` for a fixture that has shown none yet: away from the ground, or square to a
 * cylinder's axis. */
void first_direction(double last[3], const TickFixture *f);

#endif
