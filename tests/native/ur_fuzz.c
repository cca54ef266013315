/*
 * Feeds UR's compiled cycle nonsense for as many seconds as are given: states of any bytes, clocks
 * and commands of any numbers.
 *
 *     tools/native --fuzz ur PROGRAM -g -fsanitize=address,undefined -fno-sanitize-recover=all
 */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "cycle.h"

static uint64_t state = 0x9e3779b97f4a7c15u;

static uint64_t any(void)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return state;
}

static int below(int count)
{
    return (int)(any() % (uint64_t)count);
}

static double number(double low, double high)
{
    return low + (high - low) * (double)(any() >> 11) / 9007199254740992.0;
}

static double nonsense(double low, double high)
{
    static const double ODD[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 0.0, -0.0, 5e-324};
    return below(20) ? number(low, high) : ODD[below(8)];
}

static void check(bool good, const char *what)
{
    if (!good) {
        fprintf(stderr, "%s\n", what);
        exit(1);
    }
}

static uint8_t *put(uint8_t *at, uint64_t bits, int size)
{
    for (int i = size - 1; i >= 0; i--)
        *at++ = (uint8_t)(bits >> (8 * i));
    return at;
}

static uint8_t *put_numbers(uint8_t *at, int count, double most)
{
    for (int i = 0; i < count; i++) {
        double value = below(60) ? number(-most, most) : nonsense(-most, most);
        uint64_t bits;
        memcpy(&bits, &value, sizeof bits);
        at = put(at, bits, 8);
    }
    return at;
}

static long taken, answered;

static void take_some(void)
{
    UrStates states = {100.0, 2000.0, 100.0, 10.0, 500.0, 0.002, 0.001, 0.1, 0.2,
                       6, 7, 2, 1, 4, {0, UR_STATE_SIZE, 'U', 1}};
    size_t length = below(9) ? UR_STATE_SIZE : (size_t)below(2 * UR_STATE_SIZE);
    uint8_t *data = malloc(length + 1), whole[UR_STATE_SIZE];
    uint8_t *at = whole;
    memcpy(at, states.head, UR_HEAD);
    at = put_numbers(at + UR_HEAD, 1, 1.0);
    at = put_numbers(at, UR_VECTORS * UR_JOINTS, 3.0);
    for (int i = 0; i < UR_INTEGERS; i++)
        at = put(at, below(3) ? (uint64_t)below(8) : any(), 4);
    at = put_numbers(at, 2, 2.0);
    for (int i = 0; i < UR_INTEGERS; i++)
        at = put(at, below(3) ? (uint64_t)below(8) : any(), 4);
    memset(data, 0, length + 1);
    memcpy(data, whole, length < sizeof whole ? length : sizeof whole);
    UrClock clock = {nonsense(-1.0, 1.0), nonsense(-0.1, 0.1), nonsense(0.0, 1.0),
                     nonsense(-2.0, 2.0), nonsense(0.0, 1.0),  nonsense(0.0, 0.1),
                     number(0.0, 9.0)};
    UrClock before = clock;
    UrState into;
    if (!ur_take(&states, data, (int64_t)length, nonsense(-0.1, 0.1), &clock, &into)) {
        check(!memcmp(&before, &clock, sizeof clock), "a clock counts what was not taken");
    } else {
        taken++;
        check(clock.time_s >= before.time_s && clock.time_s - before.time_s < 0.004,
              "time goes back, or ahead by more than was waited for");
        check(isfinite(into.slider), "a slider that is no number");
    }
    free(data);
}

static void answer_some(void)
{
    UrCommands commands = {.largest_position = 2000.0, .largest_velocity = 100.0, .token = 7,
                           .work_off_s = 0.5, .work_off_share = 0.5, .recent_s = 5.0,
                           .speed_up_s = 0.25, .slow_down_s = 0.1, .nothing = 1e-7};
    UrSlip slip = {.fastest = number(0.0, 3.0)};
    UrReference reference = {.has_velocities = below(2), .has_target = below(2)};
    uint8_t *into = malloc(UR_COMMAND_SIZE);
    double dt_s = nonsense(1e-4, 0.02);
    for (int i = 0; i < UR_JOINTS; i++) {
        JointLimits *limits = &commands.limits;
        limits->lower[i] = below(3) ? number(-3.0, 0.0) : -INFINITY;
        limits->upper[i] = below(3) ? number(0.0, 3.0) : INFINITY;
        limits->inner_lower[i] = limits->lower[i] + number(0.0, 0.5);
        limits->inner_upper[i] = limits->upper[i] - number(0.0, 0.5);
        limits->speed[i] = number(0.01, 5.0);
        limits->acceleration[i] = number(0.1, 50.0);
        reference.positions[i] = below(30) ? number(-4.0, 4.0) : nonsense(-4.0, 4.0);
        reference.velocities[i] = below(30) ? number(-6.0, 6.0) : nonsense(-6.0, 6.0);
        reference.target[i] = number(-4.0, 4.0);
        reference.reference[i] = number(-4.0, 4.0);
        reference.velocity[i] = number(-1.0, 1.0) * limits->speed[i];
        slip.offset[i] = below(30) ? number(-0.1, 0.1) : nonsense(-0.1, 0.1);
        slip.rate[i] = number(-0.1, 0.1);
        slip.before[i] = reference.velocities[i] + number(-0.1, 0.1);
    }
    UrReference asked = reference;
    UrSlip slipped = slip;
    if (!ur_follow(&commands, &reference, dt_s, &slip))
        check(!memcmp(&asked, &reference, sizeof asked) && !memcmp(&slipped, &slip, sizeof slip),
              "a refused slip is added");
    UrReference before = reference;
    if (!ur_answer(&commands, &reference, dt_s, below(1 << 30), into)) {
        check(!memcmp(&before, &reference, sizeof before), "a refused command moves the reference");
    } else {
        answered++;
        /* A period of years overflows, as it does in Python. */
        for (int i = 0; i < UR_JOINTS && dt_s < 1.0; i++)
            check(fabs(reference.velocity[i]) <= commands.limits.speed[i] &&
                      isfinite(reference.reference[i]),
                  "faster than the limit");
    }
    free(into);
}

int main(int count, char **words)
{
    time_t end = time(NULL) + (count > 1 ? atoi(words[1]) : 1);
    while (time(NULL) < end)
        for (int i = 0; i < 1000; i++) {
            take_some();
            answer_some();
        }
    check(taken > 0 && answered > 0, "nothing was taken or answered");
    printf("%ld states taken, %ld commands answered, nothing wrong\n", taken, answered);
    return 0;
}
