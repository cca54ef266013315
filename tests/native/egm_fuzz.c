/*
 * Fuzzes what EGM's driver has compiled: layouts that are sound and not, random datagrams, random
 * limits and commands.
 *
 *     tools/native --fuzz egm PROGRAM -g -fsanitize=address,undefined -fno-sanitize-recover=all
 *     PROGRAM [SECONDS] [SEED]
 *
 * Ends with 1 where an answer is larger than its buffer, or where what is refused changes anything
 * that lasts.
 */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "answer.h"
#include "pose.h"
#include "take.h"

static uint64_t state;

static uint64_t random_bits(void)
{
    /* xorshift64* */
    state ^= state >> 12;
    state ^= state << 25;
    state ^= state >> 27;
    return state * 2685821657736338717ull;
}

static int below(int end)
{
    return (int)(random_bits() % (uint64_t)end);
}

static double uniform(double low, double high)
{
    return low + (high - low) * (double)(random_bits() >> 11) * 0x1p-53;
}

static double number(double low, double high)
{
    uint64_t bits = random_bits();
    double value;
    memcpy(&value, &bits, sizeof value);
    return below(50) ? uniform(low, high) : value;
}

static void random_layout(EgmLayout *layout, int length)
{
    layout->length = length;
    layout->forces = below(20) ? below(EGM_FORCES + 1) : (int32_t)random_bits();
    layout->has_rate = below(2);
    for (int i = 0; i < EGM_VALUES + EGM_FORCES + 1; i++) {
        bool whole = i >= 2 && i != 15 && i != 16;
        layout->size[i] = below(200) ? (whole ? 8 : 1 + below(5)) : (int32_t)random_bits();
        layout->place[i] = length > 8 ? below(length - 8) : 0;
        if (!below(200))
            layout->place[i] = below(2) ? length - 8 + below(12) : (int32_t)random_bits();
    }
    for (int i = 0; i < 3; i++)
        layout->states[i] = below(30) ? i + 1 : (int32_t)random_bits();
    for (int i = 0; i < EGM_LENGTH_MAX; i++) {
        layout->mask[i] = below(8) ? 0 : (uint8_t)random_bits();
        layout->fixed[i] = (uint8_t)random_bits() & layout->mask[i];
    }
}

static void random_cycle(EgmCycle *cycle)
{
    memset(cycle, 0, sizeof *cycle);
    cycle->nominal_s = 0.004;
    cycle->lost_after_s = cycle->late_after_s = 0.1;
    cycle->longest_gap_s = 0.006;
    cycle->jump = below(2) ? INFINITY : number(0.0, 10.0);
    cycle->usual = below(2) ? INFINITY : number(0.0, 1000.0);
    cycle->longest_squared = INFINITY;
    cycle->by_joints = below(2);
    cycle->time_us = below(3) ? (int64_t)random_bits() : -1;
    cycle->tm_ms = below(3) ? (int64_t)random_bits() : -1;
    for (int i = 0; i < 3; i++)
        cycle->states[i] = i + 1;
}

/* Whether taking a datagram changes nothing but what was found, unless it is taken. */
static bool take_one(EgmReader *reader, const uint8_t *data, int length)
{
    EgmCycle cycle, before;
    random_cycle(&cycle);
    if (egm_read(reader, data, length) >= 0 && below(4))
        cycle.seqno = reader->seqno - 1u;
    before = cycle;
    if (egm_take(&cycle, reader, data, length, number(0.0, 0.1))) {
        egm_answered(&cycle, 1, egm_answer_period(&cycle, 0.0, number(0.0, 0.1)));
        egm_answer_time(&cycle, number(0.0, 1e6));
        return cycle.out_seqno == before.out_seqno + 1u;
    }
    memcpy(cycle.turned, before.turned, sizeof cycle.turned);
    return !memcmp(&cycle, &before, sizeof cycle);
}

static bool read_some(EgmReader *reader)
{
    bool good = true;
    reader->newest = (int32_t)random_bits();
    for (int i = 0; i < EGM_LAYOUTS; i++)
        random_layout(&reader->layouts[i], below(20) ? below(EGM_LENGTH_MAX + 1) : below(100000));
    for (int i = 0; i < 4 * EGM_LAYOUTS; i++) {
        const EgmLayout *layout = &reader->layouts[below(EGM_LAYOUTS)];
        int length = below(4) ? layout->length : below(EGM_LENGTH_MAX + 100);
        if (length > 2 * EGM_LENGTH_MAX)
            length = 2 * EGM_LENGTH_MAX;
        uint8_t *data = malloc((size_t)length + 1);
        if (!data)
            abort();
        for (int at = 0; at < length; at++) {
            data[at] = (uint8_t)random_bits();
            if (at < EGM_LENGTH_MAX)
                data[at] = (uint8_t)((data[at] & ~layout->mask[at]) | layout->fixed[at]);
        }
        /* Shrunk to its size, so that a byte beyond is one too many for the sanitizer. */
        uint8_t *exact = length ? realloc(data, (size_t)length) : data;
        good &= take_one(reader, exact ? exact : data, length);
        free(exact ? exact : data);
    }
    return good;
}

static int answer_some(uint64_t seed)
{
    EgmAnswer answer;
    memset(&answer, 0, sizeof answer);
    for (int i = 0; i < EGM_JOINTS; i++) {
        answer.limits.lower[i] = below(3) ? number(-3.0, 0.0) : -INFINITY;
        answer.limits.upper[i] = below(3) ? number(0.0, 3.0) : INFINITY;
        answer.limits.inner_lower[i] = answer.limits.lower[i] + number(0.0, 0.5);
        answer.limits.inner_upper[i] = answer.limits.upper[i] - number(0.0, 0.5);
        answer.limits.speed[i] = number(0.01, 5.0);
        answer.limits.acceleration[i] = number(0.1, 50.0);
    }
    answer.largest_position = 2000.0;
    answer.largest_velocity = 1000.0;
    answer.says = below(4);
    answer.relocates = below(2);
    answer.delay_s = 0.02;
    for (int tick = 0; tick < 50; tick++) {
        double before[EGM_JOINTS];
        memcpy(before, answer.reference, sizeof before);
        for (int i = 0; i < EGM_JOINTS; i++) {
            answer.positions[i] = number(-3.0, 3.0);
            answer.velocities[i] = number(-2.0, 2.0);
        }
        if (!below(10))
            answer.has_target = 0;
        for (int i = 0; i < EGM_JOINTS; i++)
            answer.measured[i] = number(-3.0, 3.0);
        uint32_t seqno = (uint32_t)random_bits(), tm_ms = (uint32_t)random_bits();
        double dt_s = number(0.001, 0.01);
        int kind = below(4);
        int32_t size = kind == 0   ? egm_answer_speed(&answer, dt_s, seqno, tm_ms)
                       : kind == 1 ? egm_answer_hold(&answer, dt_s, seqno, tm_ms)
                                   : egm_answer(&answer, kind - 2, dt_s, seqno, tm_ms);
        if (size < 0 || size > EGM_REPLY_MAX ||
            (!size && memcmp(before, answer.reference, sizeof before))) {
            fprintf(stderr, "wrong: an answer of %d bytes; seed %llu\n", (int)size,
                    (unsigned long long)seed);
            return 1;
        }
    }
    return 0;
}

static void numbers(double *into, int count, double largest)
{
    for (int i = 0; i < count; i++)
        into[i] = number(-largest, largest);
}

static int pose_some(uint64_t seed)
{
    EgmPoseAnswer answer;
    memset(&answer, 0, sizeof answer);
    EgmPoint *point = &answer.point;
    EgmTurn *turn = &answer.turn;
    answer.largest_position = 100.0;
    answer.largest_linear = 100.0;
    answer.largest_angular = 1000.0;
    answer.shortest_squared = 0.9;
    answer.longest_squared = below(2) ? 1.1 : INFINITY;
    answer.delay_s = 0.02;
    answer.says = below(4);
    answer.relocates = below(2);
    point->has_box = below(2);
    numbers(point->lower, 3, 1.0);
    numbers(point->upper, 3, 1.0);
    point->speed = number(0.01, 5.0);
    point->acceleration = number(0.1, 50.0);
    turn->speed = number(0.01, 5.0);
    turn->acceleration = number(0.1, 50.0);
    turn->reference[0] = 1.0;
    for (int tick = 0; tick < 50; tick++) {
        EgmPoint before = *point;
        numbers(answer.position, 3, 2.0);
        numbers(answer.orientation, 4, 1.0);
        numbers(answer.linear, 3, 2.0);
        numbers(answer.angular, 3, 2.0);
        numbers(answer.measured_position, 3, 2.0);
        numbers(answer.measured_orientation, 4, 1.0);
        uint32_t seqno = (uint32_t)random_bits(), tm_ms = (uint32_t)random_bits();
        double dt_s = number(0.001, 0.01);
        int kind = below(4);
        int32_t size = kind == 0   ? egm_pose_answer_speed(&answer, dt_s, seqno, tm_ms)
                       : kind == 1 ? egm_pose_answer_hold(&answer, dt_s, seqno, tm_ms)
                                   : egm_pose_answer(&answer, kind - 2, dt_s, seqno, tm_ms);
        if (size < 0 || size > EGM_REPLY_MAX ||
            (!size && memcmp(&before, point, sizeof before))) {
            fprintf(stderr, "wrong: a pose's answer of %d bytes; seed %llu\n", (int)size,
                    (unsigned long long)seed);
            return 1;
        }
    }
    return 0;
}

int main(int count, char **words)
{
    double seconds = count > 1 ? atof(words[1]) : 10.0;
    uint64_t seed = count > 2 ? strtoull(words[2], NULL, 10) : 1;
    unsigned long long runs = 0;
    EgmReader *reader = calloc(1, sizeof *reader);
    if (!reader)
        return 1;
    clock_t end = clock() + (clock_t)(seconds * (double)CLOCKS_PER_SEC);
    for (; clock() < end; runs++, seed++) {
        state = seed * 0x9E3779B97F4A7C15ull | 1u;
        random_bits();
        if (!read_some(reader)) {
            fprintf(stderr, "wrong: a datagram that is not taken; seed %llu\n",
                    (unsigned long long)seed);
            return 1;
        }
        if (answer_some(seed) || pose_some(seed))
            return 1;
    }
    free(reader);
    printf("%llu rounds, nothing wrong\n", runs);
    return 0;
}
