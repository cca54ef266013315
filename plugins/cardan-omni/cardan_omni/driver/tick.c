#include "tick.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "checks.h"
#include "tick_internal.h"

/* How far a stamp may be ahead of the newest tick: a loop that stands still for longer has ended. */
#define AHEAD_S 1.0

int tick_command(Tick *tick, const TickCommand *command, double now_s)
{
    int wrong = check_command(command);
    if (wrong)
        return wrong;
    double ahead = tick->given_hold_s;
    if (!isfinite(now_s)) {
        now_s = atomic_load_explicit(&tick->clock_s, memory_order_relaxed);
        ahead = AHEAD_S;
    }
    if (command->stamp_s > now_s + ahead) /* false for NaN */
        return TICK_OF_THE_FUTURE;
    bool plausible = !(tick->given_stamp_s > now_s + tick->given_hold_s);
    if (tick->commanded_once && plausible &&
        (command->stamp_s < tick->given_stamp_s ||
         (command->sequence <= tick->given_sequence &&
          command->stamp_s < tick->given_stamp_s + tick->given_pause_s))) {
        atomic_fetch_add_explicit(&tick->dropped, 1u, memory_order_relaxed);
        return TICK_DROPPED;
    }
    tick->commanded_once = true;
    tick->given_sequence = command->sequence;
    tick->given_stamp_s = command->stamp_s;
    size_t used = offsetof(TickCommand, fixtures) +
                  (size_t)command->fixture_count * sizeof(TickFixture);
    memcpy(&tick->commands[tick->command_exchange.writer], command, used);
    tick->given_engagements += command->engaged && !tick->given_engaged;
    tick->given_engaged = command->engaged != 0;
    tick->engagements[tick->command_exchange.writer] = tick->given_engagements;
    exchange_give(&tick->command_exchange);
    return TICK_TAKEN;
}

int tick_set_limits(Tick *tick, const TickLimits *limits)
{
    if (!limits_are_sound(limits))
        return TICK_BAD_LIMIT;
    tick->given_pause_s = limits->pause_s;
    tick->given_hold_s = limits->hold_s;
    tick->limits_buffers[tick->limits_exchange.writer] = *limits;
    exchange_give(&tick->limits_exchange);
    return TICK_TAKEN;
}

uint32_t tick_dropped(const Tick *tick)
{
    return atomic_load_explicit(&tick->dropped, memory_order_relaxed);
}

Tick *tick_create(const TickLimits *limits)
{
    if (!limits_are_sound(limits))
        return NULL;
    Tick *tick = calloc(1, sizeof *tick);
    if (!tick)
        return NULL;
    exchange_reset(&tick->command_exchange);
    exchange_reset(&tick->limits_exchange);
    exchange_reset(&tick->snapshot_exchange);
    atomic_store(&tick->word, TICK_DISABLED | TICK_NOT_ENABLED << 8);
    tick->limits = *limits;
    tick->given_pause_s = limits->pause_s;
    tick->given_hold_s = limits->hold_s;
    atomic_store(&tick->clock_s, NAN);
    for (int i = 0; i < TICK_BUTTONS; i++)
        tick->button_s[i] = TICK_NEVER;
    for (int i = 0; i < INTERRUPTIONS; i++)
        tick->interruptions[i] = TICK_NEVER;
    tick->irregular_s = tick->slow_since_s = tick->unsound_since_s = TICK_NEVER;
    tick->period_s = TICK_PERIOD_S;
    tick->gain = 1.0;
    tick->quiet_until_s = tick->distrust_until_s = TICK_NEVER;
    tick->measured_stamp_s = TICK_NEVER;
    for (int i = 0; i < FORCE_ERRORS; i++)
        tick->force_errors[i] = TICK_NEVER;
    for (int i = 0; i < TICK_FIXTURES; i++)
        tick->direction_kinds[i] = -1;
    tick->now.stamp_s = TICK_NEVER;
    tick->now.command_age_s = tick->now.force_age_s = INFINITY;
    tick->now.thermal_derating = 1.0;
    tick->now.realtime = -1;
    tick->now.calibration = -1;
    tick->now.reason = TICK_NOT_ENABLED;
    tick->now.rotation[0] = tick->now.rotation[4] = tick->now.rotation[8] = 1.0;
    tick->snapshots[tick->snapshot_exchange.reader] = tick->now;
    return tick;
}

void tick_destroy(Tick *tick)
{
    free(tick);
}
