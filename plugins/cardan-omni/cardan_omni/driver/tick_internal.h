/* The state of a tick, for the files that make up its implementation. */
#ifndef CARDAN_OMNI_TICK_INTERNAL_H
#define CARDAN_OMNI_TICK_INTERNAL_H

#include <stdatomic.h>
#include <stdbool.h>

#include "exchange.h"
#include "tick.h"

/* Phases of an engagement. */
enum { OUT, WAITING, RAMPING, IN };

#define FORCE_ERRORS 3
#define OSCILLATION_RING 32
/* Interruptions within INTERRUPTIONS_WINDOW_S after which the tick pauses: a force that comes and goes
 * is worse than none. */
#define INTERRUPTIONS 4

struct Tick {
    /* shared */
    _Atomic uint32_t word; /* state | reason << 8 | generation << 16 */
    _Atomic uint32_t dropped;
    _Atomic uint32_t losses;
    _Atomic int inhibited; /* the motors are off */
    _Atomic double clock_s; /* of the newest tick; NaN: nothing ticks */
    Exchange command_exchange;
    TickCommand commands[3];
    uint32_t engagements[3]; /* how often commands had begun to be engaged, with each */
    Exchange limits_exchange;
    TickLimits limits_buffers[3];
    Exchange snapshot_exchange;
    TickSnapshot snapshots[3];

    /* the commanding side's */
    bool commanded_once;
    uint64_t given_sequence;
    double given_stamp_s;
    double given_pause_s;
    double given_hold_s;
    uint32_t given_engagements;
    bool given_engaged;

    /* the tick's own */
    TickLimits limits;
    const TickCommand *command; /* NULL: none yet */
    double command_seen_s;
    uint32_t generation;
    uint32_t engagement;
    bool anew; /* what comes next is an engagement of its own */
    bool was_alive;
    bool started;
    double now_s;
    bool located; /* position is one that motion can be measured from */
    double position[3];
    double moved[3]; /* since the tick before */
    double velocity[3];
    double period_s; /* smoothed */
    double sent[3];
    double directions[TICK_FIXTURES][3];
    int32_t direction_kinds[TICK_FIXTURES];
    double measured_stamp_s;
    double measured_extra[3];
    double distrust_until_s; /* the library's velocity */
    int32_t still_ticks; /* in a row, in which no time went by */
    int phase;
    int32_t small_ticks;
    double share;
    double ramp_s; /* how long the share takes to 1 */
    bool resumes;  /* the loop stood still, for a moment only, while force was out */
    double stalled_s; /* since then, where it resumes */
    bool broken;   /* force was interrupted, and is to come back by the ramp */
    double interruptions[INTERRUPTIONS];
    unsigned interruption_at;
    double irregular_s; /* the newest of them, or what would be one */
    bool slow;
    double slow_since_s;    /* TICK_NEVER: the rate is not low */
    double unsound_since_s; /* TICK_NEVER: the sample before was sound */
    double located_s;
    double given_j; /* booked as given to the hand in this engagement */
    double energy_j;
    double mean_square;
    double gain;
    int signs[3];
    double turns[3][OSCILLATION_RING];
    unsigned turn_at[3];
    int32_t buttons;
    double button_s[TICK_BUTTONS]; /* when its level changed last */
    double force_errors[FORCE_ERRORS];
    unsigned force_error_at;
    double quiet_until_s;
    double before_sent[3]; /* what was sent before `sent` */
    double own_gap_s;      /* this tick's, of which the snapshot has the longest */
    double own_cost_s;
    TickSnapshot now;
};

#endif
