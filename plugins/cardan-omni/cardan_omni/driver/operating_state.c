#include "operating_state.h"

#include <math.h>

#include "vectors.h"

#define FORCE_ERRORS_WINDOW_S 10.0

/* State, reason and generation are one word, so that a request and a fault never overwrite each
 * other. */
static uint32_t word_of(uint32_t state, uint32_t reason, uint32_t generation)
{
    return state | reason << 8 | (generation & 0xffffu) << 16;
}

int tick_request(Tick *tick, int verb)
{
    uint32_t word = atomic_load(&tick->word);
    for (;;) {
        uint32_t state = word & 0xffu, generation = word >> 16, next;
        if (verb == TICK_ENABLE && state == TICK_ENABLED)
            return 0;
        if (verb == TICK_ENABLE && (state == TICK_DISABLED || state == TICK_FAULT))
            next = word_of(TICK_ENABLED, TICK_AS_COMMANDED, generation + 1);
        else if (verb == TICK_DISABLE)
            next = word_of(TICK_DISABLED, TICK_NOT_ENABLED, generation);
        else if (verb == TICK_PAUSE && (state == TICK_ENABLED || state == TICK_PAUSED))
            next = word_of(TICK_PAUSED, TICK_PAUSED_ON_REQUEST, generation);
        else if (verb == TICK_RESUME && state == TICK_PAUSED)
            next = word_of(TICK_ENABLED, TICK_AS_COMMANDED, generation + 1);
        else
            return -1;
        if (atomic_compare_exchange_weak(&tick->word, &word, next))
            return 0;
    }
}

int tick_state(const Tick *tick)
{
    return (int)(atomic_load(&tick->word) & 0xffffu);
}

bool change_state(Tick *tick, uint32_t *word, uint32_t state, uint32_t reason)
{
    uint32_t next = word_of(state, reason, *word >> 16);
    if (!atomic_compare_exchange_strong(&tick->word, word, next))
        return false;
    *word = next;
    return true;
}

void latch_fault(Tick *tick, uint32_t *word, uint32_t reason)
{
    while ((*word & 0xffu) != TICK_FAULT)
        if (change_state(tick, word, TICK_FAULT, reason)) {
            tick->now.faults++;
            tick->phase = OUT;
        }
}

void tick_lose(Tick *tick)
{
    atomic_store(&tick->clock_s, NAN);
    uint32_t word = atomic_load(&tick->word);
    while ((word & 0xffu) != TICK_FAULT)
        if (change_state(tick, &word, TICK_FAULT, TICK_FAULT_DEVICE))
            atomic_fetch_add(&tick->losses, 1u);
}

void tick_allow(Tick *tick, int allowed)
{
    atomic_store(&tick->inhibited, !allowed);
}

void publish(Tick *tick)
{
    uint32_t word = atomic_load(&tick->word);
    tick->now.state = (int32_t)(word & 0xffu);
    if (exchange_was_taken(&tick->snapshot_exchange)) {
        tick->now.gap_s = tick->own_gap_s;
        tick->now.tick_cost_s = tick->own_cost_s;
    }
    tick->snapshots[tick->snapshot_exchange.writer] = tick->now;
    exchange_give(&tick->snapshot_exchange);
}

void tick_snapshot(Tick *tick, TickSnapshot *snapshot)
{
    exchange_take(&tick->snapshot_exchange);
    *snapshot = tick->snapshots[tick->snapshot_exchange.reader];
    snapshot->faults += atomic_load(&tick->losses);
    uint32_t word = atomic_load(&tick->word);
    if ((int32_t)(word & 0xffu) != snapshot->state) {
        snapshot->state = (int32_t)(word & 0xffu);
        snapshot->reason = (int32_t)(word >> 8 & 0xffu);
    }
}

static void note_error(Tick *tick, uint32_t code, int32_t internal)
{
    tick->now.errors++;
    tick->now.error = code;
    tick->now.internal_error = internal;
}

void tick_error(Tick *tick, uint32_t code, int32_t internal, double now_s)
{
    note_error(tick, code, internal);
    if ((code & 0xff00u) == 0x0200u) {
        tick->now.force_errors++;
        tick->quiet_until_s = now_s + tick->limits.force_error_wait_s;
        tick->phase = OUT;
        tick->force_errors[tick->force_error_at] = now_s;
        tick->force_error_at = (tick->force_error_at + 1) % FORCE_ERRORS;
        if (tick->force_errors[tick->force_error_at] > now_s - FORCE_ERRORS_WINDOW_S) {
            uint32_t word = atomic_load(&tick->word);
            latch_fault(tick, &word, TICK_FAULT_FORCE_ERRORS);
            tick->now.reason = (int32_t)(word >> 8 & 0xffu);
            for (int i = 0; i < FORCE_ERRORS; i++)
                tick->force_errors[i] = TICK_NEVER;
        }
    }
    publish(tick);
}

void tick_fatal(Tick *tick, uint32_t code, int32_t internal)
{
    note_error(tick, code, internal);
    uint32_t word = atomic_load(&tick->word);
    latch_fault(tick, &word, TICK_FAULT_DEVICE);
    tick->now.reason = (int32_t)(word >> 8 & 0xffu);
    clear(tick->sent); /* the frame was lost, and with it the force */
    set(tick->now.force, tick->sent);
    publish(tick);
}

void tick_set_realtime(Tick *tick, int realtime)
{
    tick->now.realtime = realtime;
}

void tick_set_finished(Tick *tick, int finished)
{
    tick->now.finished = finished;
    publish(tick);
}
