/* Monitors of a step beside the force: buttons, the loop's rate, interruptions, oscillation. */
#ifndef CARDAN_OMNI_MONITORS_H
#define CARDAN_OMNI_MONITORS_H

#include <stdbool.h>
#include <stdint.h>

#include "tick_internal.h"

/* Debounces the levels `raw` of the buttons and counts presses. */
void count_buttons(Tick *tick, int32_t raw, double now_s);

/* True while the loop is too slow for force. */
bool is_slow(Tick *tick, double now_s);

/* Notes an interruption; true if there were too many. */
bool too_irregular(Tick *tick, double now_s);
void forget_interruptions(Tick *tick);

/* First-order low-pass of the exact difference quotient; sound for any period, zero too. */
void filter_velocity(Tick *tick, double dt);

/* True once the velocity has changed sign often enough in the window. */
bool oscillates(Tick *tick, double now_s);
void forget_oscillation(Tick *tick);

#endif
