#include "monitors.h"

#include <math.h>

#define INTERRUPTIONS_WINDOW_S 1.0
/* Switch contacts bounce for some ms (5 to 10 by data sheet, 20 when worn), and no finger presses twice
 * within this time: the first edge counts at once, later ones only after it. */
#define BUTTON_LOCKOUT_S 0.025
/* The loop counts as slow after its rate was low for this long (one or two stalls do not count), and
 * no longer once the rate is above the lowest by this factor. */
#define SLOW_AFTER_S 0.05
#define RATE_RETURN 1.03

void count_buttons(Tick *tick, int32_t raw, double now_s)
{
    for (int i = 0; i < TICK_BUTTONS; i++) {
        if (!((raw ^ tick->buttons) >> i & 1) ||
            fabs(now_s - tick->button_s[i]) < BUTTON_LOCKOUT_S)
            continue;
        tick->button_s[i] = now_s;
        tick->buttons ^= 1 << i;
        tick->now.presses[i] += (uint32_t)(tick->buttons >> i & 1);
    }
}

bool is_slow(Tick *tick, double now_s)
{
    double rate = 1.0 / tick->period_s, lowest = tick->limits.lowest_rate_hz;
    if (rate >= lowest * (tick->slow ? RATE_RETURN : 1.0)) {
        tick->slow = false;
        tick->slow_since_s = TICK_NEVER;
    } else if (tick->slow_since_s == TICK_NEVER) {
        tick->slow_since_s = now_s;
    } else if (now_s - tick->slow_since_s >= SLOW_AFTER_S) {
        tick->slow = true;
    }
    return tick->slow;
}

bool too_irregular(Tick *tick, double now_s)
{
    tick->interruptions[tick->interruption_at] = now_s;
    tick->interruption_at = (tick->interruption_at + 1) % INTERRUPTIONS;
    return tick->interruptions[tick->interruption_at] > now_s - INTERRUPTIONS_WINDOW_S;
}

void forget_interruptions(Tick *tick)
{
    for (int i = 0; i < INTERRUPTIONS; i++)
        tick->interruptions[i] = TICK_NEVER;
}

void filter_velocity(Tick *tick, double dt)
{
    double omega = 2.0 * M_PI * tick->limits.velocity_cutoff_hz;
    for (int i = 0; i < 3; i++)
        tick->velocity[i] = (tick->velocity[i] + omega * tick->moved[i]) / (1.0 + omega * dt);
}

bool oscillates(Tick *tick, double now_s)
{
    bool found = false;
    unsigned changes = (unsigned)tick->limits.oscillation_reversals;
    for (int i = 0; i < 3; i++) {
        if (fabs(tick->velocity[i]) < tick->limits.oscillation_speed_m_s)
            continue;
        int sign = tick->velocity[i] > 0.0 ? 1 : -1;
        if (tick->signs[i] && sign != tick->signs[i]) {
            double *ring = tick->turns[i];
            ring[tick->turn_at[i] % OSCILLATION_RING] = now_s;
            tick->turn_at[i]++;
            if (tick->turn_at[i] >= changes &&
                ring[(tick->turn_at[i] - changes) % OSCILLATION_RING] > now_s - tick->limits.oscillation_window_s)
                found = true;
        }
        tick->signs[i] = sign;
    }
    if (found)
        tick->turn_at[0] = tick->turn_at[1] = tick->turn_at[2] = 0;
    return found;
}

void forget_oscillation(Tick *tick)
{
    tick->gain = 1.0;
    tick->turn_at[0] = tick->turn_at[1] = tick->turn_at[2] = 0;
}
