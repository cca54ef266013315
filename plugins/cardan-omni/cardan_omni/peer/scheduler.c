/* The scheduler: callbacks by priority in a thread of its own, or in simStep's caller. */
#include <errno.h>
#include <math.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "omni.h"

#define REALTIME_PRIORITY 80
#define RATE_OVER_S 0.2   /* what HD_UPDATE_RATE is a mean of */
#define LONGEST_GAP_S 0.1 /* of the world, after a suspended process */
#define BUS_HZ 8000
#define LEAST_RATE_HZ 10  /* slower, and the world's longest gap is no longer one */

Omni omni;
pthread_mutex_t omni_lock;

/* The thread that runs ticks in virtual time. */
static pthread_mutex_t turn;
static pthread_cond_t changed;
static pthread_t thread;
static __thread int in_servo;

void omni_enter(void) { pthread_mutex_lock(&omni_lock); }
void omni_leave(void) { pthread_mutex_unlock(&omni_lock); }

double omni_random(uint64_t *series) {
    uint64_t z = (*series += 0x9E3779B97F4A7C15u);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return (double)((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

void omni_power_on(const Settings *settings, int log_file) {
    free(omni.settings.waypoints);
    log_take(log_file);
    memset(&omni, 0, sizeof omni);
    omni.settings = *settings;
    omni.random = settings->seed;
    omni.noise = ~settings->seed;
    omni.scheduler.rate_hz = settings->rate_hz;
    omni.scheduler.mean_rate_hz = settings->rate_hz;
    omni.scheduler.period_s = 1.0 / settings->rate_hz;
    /* Opaque to a program, and wider than an int: a binding that truncates it shows here. */
    omni.scheduler.last_handle = (HDSchedulerHandle)1 << (sizeof(HDSchedulerHandle) * 8 - 24);
    device_power_on();
    hand_power_on();
    arm_power_on();
    omni_plan();
}

void omni_plan(void) {
    for (int i = 0; i < omni.settings.fault_count; i++) {
        const PlannedFault *planned = &omni.settings.faults[i];
        if (!omni.planned_done[i] && omni.elapsed_s >= planned->from_s) {
            omni.planned_done[i] = 1;
            omni_set_fault(planned->fault, planned->value);
        }
    }
}

__attribute__((constructor)) static void power_on_at_load(void) {
    pthread_mutexattr_t attributes;
    pthread_mutexattr_init(&attributes);
    pthread_mutexattr_setprotocol(&attributes, PTHREAD_PRIO_INHERIT);
    pthread_mutex_init(&omni_lock, &attributes);
    pthread_mutexattr_settype(&attributes, PTHREAD_MUTEX_RECURSIVE);
    pthread_mutex_init(&turn, &attributes);
    pthread_mutexattr_destroy(&attributes);
    pthread_cond_init(&changed, NULL);
    Settings settings;
    (void)settings_parse(&settings, NULL);
    omni_power_on(&settings, -1);
}

/* --- time ------------------------------------------------------------------------------------ */

static double monotonic(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void sleep_until(double time_s) {
    struct timespec until;
    until.tv_sec = (time_t)time_s;
    until.tv_nsec = (long)((time_s - (double)until.tv_sec) * 1e9);
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) == EINTR) {
    }
}

double scheduler_now(void) {
    const Scheduler *scheduler = &omni.scheduler;
    return omni.settings.virtual_clock ? scheduler->tick_s + scheduler->held_up_s : monotonic();
}

double simNow(void) {
    omni_enter();
    double now = scheduler_now();
    omni_leave();
    return now;
}

/* When the next tick is due; it moves the grid on. */
static double next_tick(void) {
    Scheduler *scheduler = &omni.scheduler;
    double slow_hz = omni.fault[FAULT_SLOW_TICKS];
    double period = 1.0 / (slow_hz > 0.0 ? slow_hz : scheduler->rate_hz);
    period = fmax(period, 1e-3 * omni.fault[FAULT_OVERRUN]);
    scheduler->grid_s += period;
    double due = scheduler->grid_s;
    double jitter_us = omni.fault[FAULT_JITTER];
    if (jitter_us > 0.0) {
        due += 1e-6 * jitter_us * omni_random(&omni.random);
    }
    if (scheduler->ticks % 100 == 99) {
        due += 1e-3 * omni.fault[FAULT_LATE_TICK];
    }
    return fmax(due, scheduler->tick_s + 1e-6);
}

/* Ticks whose time is over are not made up for. */
static void catch_up(double now) {
    Scheduler *scheduler = &omni.scheduler;
    double period = 1.0 / scheduler->rate_hz;
    if (now >= scheduler->grid_s + period) {
        scheduler->grid_s += period * floor((now - scheduler->grid_s) / period);
    }
}

/* --- callbacks ------------------------------------------------------------------------------- */

static Entry *find(HDSchedulerHandle handle) {
    for (int i = 0; handle && i < SCHEDULER_CALLBACKS; i++) {
        if (omni.scheduler.entries[i].handle == handle) {
            return &omni.scheduler.entries[i];
        }
    }
    return NULL;
}

static HDCallbackCode call(HDSchedulerCallback callback, void *user) {
    in_servo++;
    HDCallbackCode code = callback(user);
    in_servo--;
    return code;
}

/* Run a callback of this tick; the lock is free while it runs. */
static void run(HDSchedulerHandle handle) {
    omni_enter();
    Entry *entry = find(handle);
    if (!entry) {
        omni_leave();
        return;
    }
    entry->running = 1;
    HDSchedulerCallback callback = entry->callback;
    void *user = entry->user;
    omni_leave();
    HDCallbackCode code = call(callback, user);
    omni_enter();
    entry->running = 0;
    if (code != HD_CALLBACK_CONTINUE && entry->handle == handle) {
        entry->handle = 0;
    }
    pthread_cond_broadcast(&changed);
    omni_leave();
}

static void world_moves(double now) {
    Scheduler *scheduler = &omni.scheduler;
    double elapsed = fmax(now - scheduler->tick_s, 0.0);
    double moved = fmin(elapsed, LONGEST_GAP_S);
    scheduler->tick_s = now;
    scheduler->held_up_s = 0.0;
    scheduler->period_s = fmax(elapsed, 1e-6);
    arm_advance(moved);
    omni_plan();
}

static void tick(double now) {
    Scheduler *scheduler = &omni.scheduler;
    HDSchedulerHandle order[SCHEDULER_CALLBACKS];
    HDushort priority[SCHEDULER_CALLBACKS];
    int count = 0;
    omni_enter();
    world_moves(now);
    if (omni.fault[FAULT_DEAD_SCHEDULER] != 0.0) {
        log_row(now);
        omni_leave();
        return;
    }
    scheduler->ticks++;
    scheduler->mean_rate_hz += (1.0 / scheduler->period_s - scheduler->mean_rate_hz) *
                               fmin(1.0, scheduler->period_s / RATE_OVER_S);
    arm_tick(scheduler->period_s);
    omni.device.frame.used = 0;
    omni.device.frame.flushed = 0;
    scheduler->frame_by_synchronous = 0;
    for (int i = 0; i < SCHEDULER_CALLBACKS; i++) {
        const Entry *entry = &scheduler->entries[i];
        if (!entry->handle) {
            continue;
        }
        int at = count++;
        while (at > 0 && priority[at - 1] < entry->priority) {
            order[at] = order[at - 1];
            priority[at] = priority[at - 1];
            at--;
        }
        order[at] = entry->handle;
        priority[at] = entry->priority;
    }
    double held_up_s = 1e-3 * omni.fault[FAULT_OVERRUN];
    if (omni.settings.virtual_clock) {
        scheduler->held_up_s = held_up_s;
    }
    int sleeps = held_up_s > 0.0 && !omni.settings.virtual_clock;
    omni_leave();
    if (sleeps) {
        sleep_until(now + held_up_s);
    }
    for (int i = 0; i < count; i++) {
        run(order[i]);
    }
    omni_enter();
    device_end_of_tick();
    log_row(now);
    omni_leave();
}

static void *serve(void *unused) {
    for (;;) {
        omni_enter();
        double due = next_tick();
        omni_leave();
        sleep_until(due);
        omni_enter();
        int stopping = omni.scheduler.stopping;
        double now = monotonic();
        catch_up(now);
        omni_leave();
        if (stopping) {
            return unused;
        }
        tick(now);
    }
}

static void take_priority(void) {
    struct sched_param parameter = {.sched_priority = REALTIME_PRIORITY};
    /* Without the permission the thread runs as any other. */
    (void)pthread_setschedparam(thread, SCHED_FIFO, &parameter);
}

/* --- HDAPI ----------------------------------------------------------------------------------- */

HD_API void hdStartScheduler(void) {
    omni_enter();
    Scheduler *scheduler = &omni.scheduler;
    if (scheduler->started) {
        push_error(HD_INVALID_OPERATION, 0);
        omni_leave();
        return;
    }
    if (!omni.device.initiated && device_take_environment()) {
        push_error(HD_TIMER_ERROR, 0);
        omni_leave();
        return;
    }
    scheduler->stopping = 0;
    scheduler->started = 1;
    arm_silence();
    arm_sample_now();
    if (!omni.settings.virtual_clock) {
        scheduler->tick_s = scheduler->grid_s = monotonic();
        int refused = pthread_create(&thread, NULL, serve, NULL);
        if (refused) {
            scheduler->started = 0;
            push_error(HD_TIMER_ERROR, refused);
        } else {
            take_priority();
            log_start();
        }
    }
    omni_leave();
}

void scheduler_stop(void) {
    omni_enter();
    Scheduler *scheduler = &omni.scheduler;
    if (!scheduler->started || scheduler->stopping || in_servo) {
        omni_leave();
        return;
    }
    scheduler->stopping = 1;
    int threaded = !omni.settings.virtual_clock;
    omni_leave();
    if (threaded) {
        pthread_join(thread, NULL);
        log_stop();
    } else {
        pthread_mutex_lock(&turn); /* a tick on its way ends first */
    }
    omni_enter();
    scheduler->started = 0;
    scheduler->stopping = 0;
    omni.device.frame.used = 0;
    arm_silence();
    log_row(scheduler_now());
    pthread_cond_broadcast(&changed);
    omni_leave();
    if (!threaded) {
        pthread_mutex_unlock(&turn);
    }
}

HD_API void hdStopScheduler(void) {
    if (in_servo) {
        omni_enter();
        push_error(HD_INVALID_OPERATION, 0);
        omni_leave();
        return;
    }
    scheduler_stop();
    log_flush();
}

/* Every so many of the FireWire bus's 8000 cycles in a second, rounded: 500, 1000, 1600, 1333... */
static int is_rate(HDulong rate_hz) {
    if (rate_hz < LEAST_RATE_HZ || rate_hz > BUS_HZ) {
        return 0;
    }
    double cycles = round((double)BUS_HZ / (double)rate_hz);
    return floor((double)BUS_HZ / cycles + 0.5) == (double)rate_hz;
}

HD_API void hdSetSchedulerRate(HDulong rate_hz) {
    omni_enter();
    if (is_rate(rate_hz)) {
        omni.scheduler.rate_hz = (int)rate_hz;
    } else {
        push_error(HD_INVALID_VALUE, 0);
    }
    omni_leave();
}

static HDSchedulerHandle add(HDSchedulerCallback callback, void *user, HDushort priority,
                             int synchronous) {
    if (!callback) {
        push_error(HD_INVALID_VALUE, 0);
        return 0;
    }
    for (int i = 0; i < SCHEDULER_CALLBACKS; i++) {
        Entry *entry = &omni.scheduler.entries[i];
        if (!entry->handle && !entry->running) {
            *entry = (Entry){
                .handle = ++omni.scheduler.last_handle,
                .callback = callback,
                .user = user,
                .priority = priority,
                .synchronous = synchronous,
            };
            return entry->handle;
        }
    }
    push_error(HD_SCHEDULER_FULL, 0);
    return 0;
}

HD_API HDSchedulerHandle hdScheduleAsynchronous(HDSchedulerCallback callback, void *user,
                                                HDushort priority) {
    omni_enter();
    HDSchedulerHandle handle = add(callback, user, priority, 0);
    omni_leave();
    return handle;
}

/* In virtual time the caller is the scheduler: now, and after each further tick, until DONE. A
 * frame of an earlier such call counts as one of an earlier tick. */
static void synchronous_here(HDSchedulerCallback callback, void *user) {
    HDCallbackCode code;
    pthread_mutex_lock(&turn);
    do {
        omni_enter();
        Frame *frame = &omni.device.frame;
        if (omni.scheduler.frame_by_synchronous) {
            frame->used = 0;
        }
        int used = frame->used;
        omni_leave();
        code = call(callback, user);
        omni_enter();
        omni.scheduler.frame_by_synchronous = frame->used && !used;
        omni_leave();
    } while (code == HD_CALLBACK_CONTINUE && simStep(1) == 1);
    pthread_mutex_unlock(&turn);
}

HD_API void hdScheduleSynchronous(HDSchedulerCallback callback, void *user, HDushort priority) {
    omni_enter();
    Scheduler *scheduler = &omni.scheduler;
    if (!callback) {
        push_error(HD_INVALID_VALUE, 0);
        omni_leave();
        return;
    }
    if (in_servo || !scheduler->started) {
        omni_leave();
        call(callback, user);
        return;
    }
    if (omni.settings.virtual_clock) {
        omni_leave();
        synchronous_here(callback, user);
        return;
    }
    HDSchedulerHandle handle = add(callback, user, priority, 1);
    while (handle && find(handle) && scheduler->started) {
        pthread_cond_wait(&changed, &omni_lock);
    }
    Entry *entry = find(handle);
    if (entry) { /* stopped before its turn came: as without a scheduler */
        entry->handle = 0;
        omni_leave();
        call(callback, user);
        return;
    }
    omni_leave();
}

HD_API void hdUnschedule(HDSchedulerHandle handle) {
    omni_enter();
    Entry *entry = find(handle);
    if (!entry) {
        push_error(HD_INVALID_OPERATION, 0);
    } else {
        entry->handle = 0;
        /* Its data may go when this returns. */
        while (entry->running && !in_servo) {
            pthread_cond_wait(&changed, &omni_lock);
        }
    }
    omni_leave();
}

HD_API HDboolean hdWaitForCompletion(HDSchedulerHandle handle, HDWaitCode code) {
    omni_enter();
    if (code != HD_WAIT_CHECK_STATUS && code != HD_WAIT_INFINITE) {
        push_error(HD_INVALID_ENUM, 0);
        omni_leave();
        return HD_FALSE;
    }
    if (code == HD_WAIT_CHECK_STATUS) {
        HDboolean scheduled = find(handle) != NULL;
        omni_leave();
        return scheduled;
    }
    if (in_servo) { /* it would wait for itself */
        push_error(HD_INVALID_OPERATION, 0);
        omni_leave();
        return HD_FALSE;
    }
    while (find(handle) && omni.scheduler.started) {
        if (omni.settings.virtual_clock) {
            omni_leave();
            int stepped = simStep(1);
            omni_enter();
            if (stepped < 1) {
                break;
            }
        } else {
            pthread_cond_wait(&changed, &omni_lock);
        }
    }
    HDboolean finished = !find(handle);
    omni_leave();
    return finished;
}

HD_API HDdouble hdGetSchedulerTimeStamp(void) {
    omni_enter();
    double since = omni.scheduler.ticks ? scheduler_now() - omni.scheduler.tick_s : 0.0;
    omni_leave();
    return since;
}

int simStep(int ticks) {
    if (in_servo) {
        return 0;
    }
    pthread_mutex_lock(&turn);
    int done = 0;
    for (int i = 0; i < ticks; i++) {
        omni_enter();
        Scheduler *scheduler = &omni.scheduler;
        if (!omni.settings.virtual_clock || !scheduler->started || scheduler->stopping) {
            omni_leave();
            break;
        }
        double now = next_tick();
        catch_up(now);
        uint64_t before = scheduler->ticks;
        omni_leave();
        tick(now);
        log_keep_up();
        omni_enter();
        done += scheduler->ticks != before;
        omni_leave();
    }
    pthread_mutex_unlock(&turn);
    return done;
}
