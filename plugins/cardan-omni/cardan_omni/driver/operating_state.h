/* The operating state, faults, and the snapshots in which the device's thread publishes them. */
#ifndef CARDAN_OMNI_OPERATING_STATE_H
#define CARDAN_OMNI_OPERATING_STATE_H

#include <stdbool.h>
#include <stdint.h>

#include "tick_internal.h"

/* From the device's thread: to `state` because of `reason`, unless a request came since `*word` was
 * read. */
bool change_state(Tick *tick, uint32_t *word, uint32_t state, uint32_t reason);

/* From the device's thread: FAULT, latched whatever was requested meanwhile. */
void latch_fault(Tick *tick, uint32_t *word, uint32_t reason);

/* From the device's thread: hands the snapshot in `tick->now` to the reader. */
void publish(Tick *tick);

#endif
