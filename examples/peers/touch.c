/* touch.c: a floor 10 mm below the origin; prints the stylus's position. */
#include <dlfcn.h>
#include <stdio.h>
#include <unistd.h>

#include "hdapi.h"

static HHD (*init)(HDstring);
static void (*begin)(HHD), (*end)(HHD), (*disable)(HHD), (*enable)(HDenum), (*start)(void),
    (*stop)(void), (*get)(HDenum, HDdouble *), (*set)(HDenum, const HDdouble *);
static HDSchedulerHandle (*schedule)(HDSchedulerCallback, void *, HDushort);

static HHD device;
static volatile double height_mm, force_n;

static HDCallbackCode tick(void *user) {
    double position[3], force[3] = {0, 0, 0};
    (void)user;
    begin(device);
    get(HD_CURRENT_POSITION, position);
    if (position[1] < -10.0) {
        force[1] = 0.3 * (-10.0 - position[1]); /* 0.3 N/mm */
    }
    set(HD_CURRENT_FORCE, force);
    end(device);
    height_mm = position[1];
    force_n = force[1];
    return HD_CALLBACK_CONTINUE;
}

int main(void) {
    void *hd = dlopen("libHD.so", RTLD_NOW | RTLD_GLOBAL);
    if (!hd) {
        fprintf(stderr, "%s\n", dlerror());
        return 1;
    }
    *(void **)&init = dlsym(hd, "hdInitDevice");
    *(void **)&disable = dlsym(hd, "hdDisableDevice");
    *(void **)&enable = dlsym(hd, "hdEnable");
    *(void **)&begin = dlsym(hd, "hdBeginFrame");
    *(void **)&end = dlsym(hd, "hdEndFrame");
    *(void **)&get = dlsym(hd, "hdGetDoublev");
    *(void **)&set = dlsym(hd, "hdSetDoublev");
    *(void **)&schedule = dlsym(hd, "hdScheduleAsynchronous");
    *(void **)&start = dlsym(hd, "hdStartScheduler");
    *(void **)&stop = dlsym(hd, "hdStopScheduler");
    device = init(HD_DEFAULT_DEVICE);
    if (device == HD_INVALID_HANDLE) {
        return 1;
    }
    enable(HD_FORCE_OUTPUT);
    schedule(tick, NULL, HD_MAX_SCHEDULER_PRIORITY);
    start();
    for (int i = 0; i < 10; i++) {
        usleep(500000);
        printf("%6.1f mm %5.2f N\n", height_mm, force_n);
        fflush(stdout);
    }
    stop();
    disable(device);
    return 0;
}
