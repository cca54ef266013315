/* The energy bound of tick.h, and the slew limit that it relies on. */
#ifndef CARDAN_OMNI_ENERGY_H
#define CARDAN_OMNI_ENERGY_H

#include <stdbool.h>

#include "tick_internal.h"

/* Upper bound of the work still to be booked if `force` is sent now and falls to zero from then on: R(F)
 * of tick.h. `sent` is the force before it, whose work may not be booked yet. */
double most_work(const double force[3], const double sent[3], const double moved[3], double fall,
                 double error);

/* From `from` towards `target` as far as the slew limit lets it. */
void slew(double to[3], const double from[3], const double target[3], double rise, double fall);

/* Reduces `force` so that the energy tank never runs empty; true if it had to. The part that does work
 * on the stylus goes first; where that is not enough the force falls along its own direction, which is
 * always allowed. */
bool spare_energy(Tick *tick, double force[3], double rise, double fall, double tank);

#endif
