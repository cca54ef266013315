/* Intercepts the calls from libHD's scheduler to a callback and from the callback to libHD's
 * functions, and records their times. Compiled by the benchmark. */
#include "hdapi.h"

#include <math.h>
#include <pthread.h>
#include <sched.h>
#include <stdint.h>
#include <time.h>

#define PROBE_API __attribute__((visibility("default")))

typedef struct {
    double begin_s; /* entry of the callback, CLOCK_MONOTONIC */
    double cost_s;  /* until it returned */
    double sent_s;  /* when the frame had ended */
    double force_n[3];
} Tick;

typedef struct {
    HDSchedulerCallback inner;
    void *user;
    void (*set_doublev)(HDenum name, const HDdouble *values);
    void (*end_frame)(HHD handle);
    Tick *ticks;
    int64_t room;
    int64_t count;
    int64_t ordinary; /* 1: take real-time scheduling from the thread */
} Probe;

static Probe *probe;
static double force[3];
static double sent_s;

static double now_s(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

PROBE_API void probe_use(Probe *which) { probe = which; }

PROBE_API void probe_set_doublev(HDenum name, const HDdouble *values) {
    if (name == HD_CURRENT_FORCE)
        for (int i = 0; i < 3; i++) force[i] = values[i];
    probe->set_doublev(name, values);
}

PROBE_API void probe_end_frame(HHD handle) {
    probe->end_frame(handle);
    sent_s = now_s();
}

PROBE_API HDCallbackCode probe_callback(void *unused) {
    double begin_s = now_s();
    for (int i = 0; i < 3; i++) force[i] = 0.0;
    sent_s = NAN;
    if (probe->ordinary) {
        struct sched_param none = {0};
        pthread_setschedparam(pthread_self(), SCHED_OTHER, &none);
        probe->ordinary = 0;
    }
    HDCallbackCode code = probe->inner(probe->user);
    double cost_s = now_s() - begin_s;
    int64_t at = probe->count;
    if (at < probe->room) {
        Tick *tick = &probe->ticks[at];
        tick->begin_s = begin_s;
        tick->cost_s = cost_s;
        tick->sent_s = sent_s;
        for (int i = 0; i < 3; i++) tick->force_n[i] = force[i];
        __atomic_store_n(&probe->count, at + 1, __ATOMIC_RELEASE);
    }
    return code;
}

/* A libHD that does nothing, to time its callers: its device rests at the origin. */
static double virtual_s;

PROBE_API void nothing_frame(HHD handle) {}
PROBE_API void nothing_booleanv(HDenum name, HDboolean *values) { *values = HD_FALSE; }
PROBE_API void nothing_integerv(HDenum name, HDint *values) { *values = 0; }
PROBE_API void nothing_longv(HDenum name, HDlong *values) {}
PROBE_API void nothing_set_doublev(HDenum name, const HDdouble *values) {
    if (name == HD_CURRENT_FORCE)
        for (int i = 0; i < 3; i++) force[i] = values[i];
}
PROBE_API void nothing_doublev(HDenum name, HDdouble *values) {
    int count = name == HD_CURRENT_TRANSFORM ? 16 : 3;
    for (int i = 0; i < count; i++) values[i] = count == 16 && i % 5 == 0 ? 1.0 : 0.0;
}
PROBE_API HDenum nothing_calibration(void) { return HD_CALIBRATION_OK; }
PROBE_API HDErrorInfo nothing_error(void) {
    HDErrorInfo none = {HD_SUCCESS, 0, 0};
    return none;
}
PROBE_API double nothing_now(void) { return virtual_s; }

/* Run ticks of 1 ms back to back; record the cost of each, s. */
PROBE_API void probe_run(HDSchedulerCallback callback, void *user, int64_t count, double *costs_s,
                         double *last_force_n) {
    for (int64_t i = 0; i < count; i++) {
        virtual_s += 1e-3;
        double begin_s = now_s();
        callback(user);
        costs_s[i] = now_s() - begin_s;
    }
    for (int i = 0; i < 3; i++) last_force_n[i] = force[i];
}
