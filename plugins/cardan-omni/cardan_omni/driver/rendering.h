/* The force that a command asks for. */
#ifndef CARDAN_OMNI_RENDERING_H
#define CARDAN_OMNI_RENDERING_H

#include "tick_internal.h"

/* Evaluates the tick's command at its position and velocity: force in N, hand frame. */
void render(Tick *tick, const TickSample *sample, double now_s, double force[3]);

#endif
