/* Whether limits and commands from outside can be used. */
#ifndef CARDAN_OMNI_CHECKS_H
#define CARDAN_OMNI_CHECKS_H

#include <stdbool.h>

#include "tick.h"

/* True if the limits are finite, consistent and, unless `unchecked`, within the device's ranges. */
bool limits_are_sound(const TickLimits *limits);

/* TICK_TAKEN, or what is wrong with the command. */
int check_command(const TickCommand *command);

#endif
