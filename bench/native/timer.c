/*
 * Baseline of a periodic loop: it waits for each instant, and does nothing.
 *
 *     timer PERIOD_US SECONDS      prints a JSON object: instants, those missed, and the median and
 *                                  p99 of the lateness, ns
 *
 * An instant is missed if the next one is due before it has begun.
 */
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>

#define S_NS 1000000000LL
#define PRIORITY 10

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * S_NS + t.tv_nsec;
}

static int by_size(const void *a, const void *b)
{
    int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

int main(int count, char **words)
{
    struct sched_param priority = {.sched_priority = PRIORITY};
    int64_t period_ns = count == 3 ? 1000LL * atoll(words[1]) : 0;
    int64_t instants = period_ns > 0 ? (int64_t)(atof(words[2]) * S_NS) / period_ns : 0, missed = 0;
    if (instants < 1) {
        fputs("timer PERIOD_US SECONDS\n", stderr);
        return 2;
    }
    int64_t *late_ns = calloc((size_t)instants, sizeof *late_ns), begun = 0;
    if (late_ns == NULL) {
        perror("timer");
        return 1;
    }
    /* Without the permission it is an ordinary process, like a session. */
    (void)!sched_setscheduler(0, SCHED_FIFO, &priority);
    (void)!mlockall(MCL_CURRENT | MCL_FUTURE);
    int64_t start_ns = now_ns();
    for (int64_t i = 1; i <= instants; i++) {
        int64_t due_ns = start_ns + i * period_ns;
        struct timespec due = {.tv_sec = due_ns / S_NS, .tv_nsec = due_ns % S_NS};
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL) != 0)
            ;
        int64_t late = now_ns() - due_ns;
        late_ns[begun++] = late;
        missed += late / period_ns;
        i += late / period_ns;
    }
    qsort(late_ns, (size_t)begun, sizeof *late_ns, by_size);
    printf("{\"instants\": %lld, \"missed\": %lld, \"p50_ns\": %lld, \"p99_ns\": %lld}\n",
           (long long)instants, (long long)missed, (long long)late_ns[begun / 2],
           (long long)late_ns[begun * 99 / 100]);
    return 0;
}
