/* The settings' text, faults by name, and the log of the ground truth. */
#include <errno.h>
#include <fcntl.h>
#include <locale.h>
#include <math.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "omni.h"

#define WORDS 24
#define FIREWIRE_NOISE_LSB 5.0
#define MOST_SETTINGS_BYTES (1 << 20)

static char problem[512];

void settings_problem(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(problem, sizeof problem, format, arguments);
    va_end(arguments);
}

const char *simProblem(void) { return problem; }

/* Numbers have a point whatever the program's locale is. */
static locale_t plain_locale(void) {
    static locale_t plain;
    if (!plain) {
        plain = newlocale(LC_ALL_MASK, "C", (locale_t)0);
    }
    return plain;
}

/* --- faults ---------------------------------------------------------------------------------- */

typedef struct {
    const char *name;
    double least, most; /* of a value that is not 0 */
} FaultKind;

static const FaultKind FAULTS[FAULT_COUNT] = {
    [FAULT_COMM_ERROR] = {"comm-error", 1, 1},
    [FAULT_UNPLUG] = {"unplug", 1, 1},
    [FAULT_LATE_TICK] = {"late-tick", 0.001, 1000},
    [FAULT_OVERRUN] = {"overrun", 0.001, 1000},
    [FAULT_WARM_MOTORS] = {"warm-motors", 0.001, 10},
    [FAULT_OVER_FORCE] = {"over-force", 0.001, 100},
    [FAULT_UNCALIBRATED] = {"uncalibrated", 1, 1},
    [FAULT_BUTTON_BOUNCE] = {"button-bounce", 0.001, 1000},
    [FAULT_STUCK_ENCODER] = {"stuck-encoder", 1, 3},
    [FAULT_JITTER] = {"jitter", 0.001, 1e6},
    [FAULT_SLOW_TICKS] = {"slow-ticks", 1, 4000},
    [FAULT_INIT_FAILS] = {"init-fails", 1, 65535},
    [FAULT_NO_LICENSE] = {"no-license", 1, 1},
    [FAULT_DEAD_SCHEDULER] = {"dead-scheduler", 1, 1},
};

int settings_fault(const char *name) {
    for (int i = 0; i < FAULT_COUNT; i++) {
        if (strcmp(FAULTS[i].name, name) == 0) {
            return i;
        }
    }
    return -1;
}

static int fault_value_fits(int fault, double value) {
    return value == 0.0 || (value >= FAULTS[fault].least && value <= FAULTS[fault].most);
}

/* --- the text -------------------------------------------------------------------------------- */

typedef struct {
    int number;
    char *words[WORDS];
    int count;
    char *rest; /* all after the key */
} Line;

static int number_at(const Line *line, int index, const char *what, double least, double most,
                     double *value) {
    char *end;
    const char *word = line->words[index];
    double read = strtod_l(word, &end, plain_locale());
    if (end == word || *end || !isfinite(read)) {
        settings_problem("line %d: %s: %s is a number, not '%.40s'", line->number, line->words[0],
                         what, word);
        return -1;
    }
    if (read < least || read > most) {
        settings_problem("line %d: %s: %s is from %g to %g, not %.40s", line->number,
                         line->words[0], what, least, most, word);
        return -1;
    }
    *value = read;
    return 0;
}

static int expect(const Line *line, int values, const char *form) {
    if (line->count - 1 != values) {
        settings_problem("line %d: it is '%s'; there %s %d value%s", line->number, form,
                         line->count == 2 ? "is" : "are", line->count - 1,
                         line->count == 2 ? "" : "s");
        return -1;
    }
    return 0;
}

static int choice_at(const Line *line, int index, const char *const choices[2], int *chosen) {
    for (int i = 0; i < 2; i++) {
        if (strcmp(line->words[index], choices[i]) == 0) {
            *chosen = i;
            return 0;
        }
    }
    settings_problem("line %d: %s is '%s' or '%s', not '%.40s'", line->number, line->words[0],
                     choices[0], choices[1], line->words[index]);
    return -1;
}

static int text_of(const Line *line, char *text, size_t size) {
    const char *from = line->rest;
    size_t length = strlen(from);
    while (length && (from[length - 1] == ' ' || from[length - 1] == '\t')) {
        length--;
    }
    if (length >= 2 && from[0] == '"' && from[length - 1] == '"') {
        from++;
        length -= 2;
    }
    if (length == 0 || length >= size) {
        settings_problem("line %d: %s takes a text of 1 to %zu bytes, not of %zu", line->number,
                         line->words[0], size - 1, length);
        return -1;
    }
    memcpy(text, from, length);
    text[length] = 0;
    return 0;
}

static int read_waypoint(const Line *line, Settings *settings) {
    static const char *const NAMES[] = {"T",       "X",      "Y",  "Z",  "RX", "RY", "RZ", "GRIP",
                                        "BUTTONS", "DOCKED", "PX", "PY", "PZ", "KX", "KY", "KZ"};
    static const double LEAST[] = {0, -1, -1, -1, -100, -100, -100, 0,
                                   0, 0,  -50, -50, -50, 0,   0,    0};
    static const double MOST[] = {1e6, 1, 1,  1,  100, 100,   100,   1,
                                  3,   1, 50, 50, 50,  20000, 20000, 20000};
    if (expect(line, 16,
               "waypoint T X Y Z RX RY RZ GRIP BUTTONS DOCKED PX PY PZ KX KY KZ")) {
        return -1;
    }
    double v[16];
    for (int i = 0; i < 16; i++) {
        if (number_at(line, i + 1, NAMES[i], LEAST[i], MOST[i], &v[i])) {
            return -1;
        }
        if (i >= 7 && i <= 9 && v[i] != floor(v[i])) {
            settings_problem("line %d: waypoint: %s is a whole number, not %.40s", line->number,
                             NAMES[i], line->words[i + 1]);
            return -1;
        }
    }
    size_t count = settings->waypoint_count;
    if (count && v[0] < settings->waypoints[count - 1].time_s) {
        settings_problem("line %d: waypoint: T goes back, from %g to %g", line->number,
                         settings->waypoints[count - 1].time_s, v[0]);
        return -1;
    }
    if ((count & (count - 1)) == 0) { /* a power of two is full */
        Waypoint *more = realloc(settings->waypoints, (count ? 2 * count : 1) * sizeof *more);
        if (!more) {
            settings_problem("line %d: waypoint: no memory", line->number);
            return -1;
        }
        settings->waypoints = more;
    }
    Waypoint *point = &settings->waypoints[settings->waypoint_count++];
    point->time_s = v[0];
    for (int i = 0; i < 3; i++) {
        point->position_m[i] = v[1 + i];
        point->turn_rad[i] = v[4 + i];
        point->push_n[i] = v[10 + i];
        point->stiffness_n_m[i] = v[13 + i];
    }
    point->gripped = (int)v[7];
    point->buttons = (int)v[8];
    point->docked = (int)v[9];
    return 0;
}

static int read_fault(const Line *line, Settings *settings) {
    if (line->count != 3 && line->count != 4) {
        return expect(line, 3, "fault NAME VALUE [FROM_S]");
    }
    int fault = settings_fault(line->words[1]);
    if (fault < 0) {
        settings_problem("line %d: there is no fault '%.40s'", line->number, line->words[1]);
        return -1;
    }
    if (settings->fault_count == PLANNED_FAULTS) {
        settings_problem("line %d: more than %d faults", line->number, PLANNED_FAULTS);
        return -1;
    }
    PlannedFault planned = {.fault = (Fault)fault};
    if (number_at(line, 2, "VALUE", 0, 1e6, &planned.value)) {
        return -1;
    }
    if (!fault_value_fits(fault, planned.value)) {
        settings_problem("line %d: fault %s: VALUE is 0 or from %g to %g, not %.40s", line->number,
                         FAULTS[fault].name, FAULTS[fault].least, FAULTS[fault].most,
                         line->words[2]);
        return -1;
    }
    if (line->count == 4 && number_at(line, 3, "FROM_S", 0, 1e6, &planned.from_s)) {
        return -1;
    }
    settings->faults[settings->fault_count++] = planned;
    return 0;
}

static int read_numbers(const Line *line, int count, const char *form, const char *const names[],
                        const double least[], const double most[], double values[]) {
    if (expect(line, count, form)) {
        return -1;
    }
    for (int i = 0; i < count; i++) {
        if (number_at(line, i + 1, names[i], least[i], most[i], &values[i])) {
            return -1;
        }
    }
    return 0;
}

static int read_one(const Line *line, const char *form, const char *name, double least, double most,
                    double *value) {
    return read_numbers(line, 1, form, &name, &least, &most, value);
}

static int read_line(const Line *line, Settings *settings) {
    static const char *const CLOCKS[] = {"real", "virtual"};
    static const char *const POWERED[] = {"cold", "calibrated"};
    const char *key = line->words[0];
    double value;
    if (strcmp(key, "clock") == 0) {
        return expect(line, 1, "clock real|virtual") ||
                       choice_at(line, 1, CLOCKS, &settings->virtual_clock)
                   ? -1
                   : 0;
    }
    if (strcmp(key, "powered") == 0) {
        return expect(line, 1, "powered calibrated|cold") ||
                       choice_at(line, 1, POWERED, &settings->calibrated)
                   ? -1
                   : 0;
    }
    if (strcmp(key, "seed") == 0) {
        char *end;
        if (expect(line, 1, "seed N")) {
            return -1;
        }
        errno = 0;
        settings->seed = strtoull(line->words[1], &end, 10);
        if (*end || errno || line->words[1][0] < '0' || line->words[1][0] > '9') {
            settings_problem("line %d: seed is a whole number below 2^64, not '%.40s'",
                             line->number, line->words[1]);
            return -1;
        }
        return 0;
    }
    if (strcmp(key, "rate") == 0) {
        if (read_one(line, "rate HZ", "HZ", 10, 4000, &value)) {
            return -1;
        }
        settings->rate_hz = (int)lround(value);
        return 0;
    }
    if (strcmp(key, "grip") == 0) {
        if (read_one(line, "grip 0|1", "it", 0, 1, &value)) {
            return -1;
        }
        settings->gripped = value != 0.0;
        return 0;
    }
    if (strcmp(key, "mass") == 0) {
        return read_one(line, "mass KG", "KG", 0.005, 2, &settings->mass_kg);
    }
    if (strcmp(key, "friction") == 0) {
        return read_one(line, "friction N", "N", 0, 5, &settings->friction_n);
    }
    if (strcmp(key, "viscous") == 0) {
        return read_one(line, "viscous N_S_M", "N_S_M", 0, 50, &settings->viscous_n_s_m);
    }
    if (strcmp(key, "droop") == 0) {
        return read_one(line, "droop N", "N", 0, 5, &settings->droop_n);
    }
    if (strcmp(key, "gimbal_noise") == 0) {
        return read_one(line, "gimbal_noise LSB", "LSB", 0, 200, &settings->gimbal_noise_lsb);
    }
    if (strcmp(key, "thermal") == 0) {
        return read_one(line, "thermal TAU_S", "TAU_S", 0.01, 1e5, &settings->thermal_s);
    }
    if (strcmp(key, "loop") == 0) {
        return read_one(line, "loop T", "T", 0.001, 1e6, &settings->loop_s);
    }
    if (strcmp(key, "hand") == 0) {
        static const char *const NAMES[] = {"KG", "N_S_M", "N_M"};
        static const double LEAST[] = {0, 0, 0};
        static const double MOST[] = {10, 200, 20000};
        double v[3];
        if (read_numbers(line, 3, "hand KG N_S_M N_M", NAMES, LEAST, MOST, v)) {
            return -1;
        }
        settings->hand_mass_kg = v[0];
        settings->hand_damping_n_s_m = v[1];
        settings->hand_stiffness_n_m = v[2];
        return 0;
    }
    if (strcmp(key, "gimbal") == 0) {
        static const char *const NAMES[] = {"SX", "SY", "SZ", "OX", "OY", "OZ"};
        static const double LEAST[] = {-10, -10, -10, -10, -10, -10};
        static const double MOST[] = {10, 10, 10, 10, 10, 10};
        double v[6];
        if (read_numbers(line, 6, "gimbal SX SY SZ OX OY OZ", NAMES, LEAST, MOST, v)) {
            return -1;
        }
        memcpy(settings->gimbal_scale, v, sizeof settings->gimbal_scale);
        memcpy(settings->gimbal_offset_rad, v + 3, sizeof settings->gimbal_offset_rad);
        return 0;
    }
    if (strcmp(key, "waypoint") == 0) {
        return read_waypoint(line, settings);
    }
    if (strcmp(key, "fault") == 0) {
        return read_fault(line, settings);
    }
    if (strcmp(key, "model") == 0) {
        if (text_of(line, settings->model, sizeof settings->model)) {
            return -1;
        }
        if (strcmp(settings->model, "PHANTOM Omni") && strcmp(settings->model, "Touch")) {
            settings_problem("line %d: model is \"PHANTOM Omni\" or \"Touch\", not '%s'",
                             line->number, settings->model);
            return -1;
        }
        return 0;
    }
    if (strcmp(key, "serial") == 0) {
        return text_of(line, settings->serial, sizeof settings->serial);
    }
    if (strcmp(key, "device") == 0) {
        return text_of(line, settings->device, sizeof settings->device);
    }
    if (strcmp(key, "log") == 0) {
        return text_of(line, settings->log, sizeof settings->log);
    }
    settings_problem("line %d: there is no setting '%.40s'", line->number, key);
    return -1;
}

static void settings_defaults(Settings *settings) {
    *settings = (Settings){
        .rate_hz = 1000,
        .calibrated = 1,
        .mass_kg = 0.045,
        .friction_n = 0.26,
        .viscous_n_s_m = 0.1,
        .droop_n = 0.3,
        .hand_mass_kg = 0.2,
        .hand_damping_n_s_m = 5.0,
        .hand_stiffness_n_m = 200.0,
        .gripped = 1,
        .thermal_s = 80.0,
        .gimbal_scale = {1.0, 1.0, 1.0},
        .gimbal_noise_lsb = -1.0,
        .model = "PHANTOM Omni",
        .serial = "60907300123",
    };
}

static void choose_noise(Settings *settings) {
    if (settings->gimbal_noise_lsb < 0.0) {
        settings->gimbal_noise_lsb = strcmp(settings->model, "Touch") ? FIREWIRE_NOISE_LSB : 0.0;
    }
}

static void drop(Settings *settings) {
    free(settings->waypoints);
    settings->waypoints = NULL;
    settings->waypoint_count = 0;
}

int settings_parse(Settings *settings, const char *text) {
    settings_defaults(settings);
    char *copy = strdup(text ? text : "");
    if (!copy) {
        settings_problem("no memory for the settings");
        return -1;
    }
    int bad = 0;
    char *at = copy;
    for (int number = 1; at && !bad; number++) {
        char *next = strchr(at, '\n');
        if (next) {
            *next++ = 0;
        }
        size_t length = strlen(at);
        if (length && at[length - 1] == '\r') {
            at[length - 1] = 0;
        }
        at += strspn(at, " \t");
        if (*at && *at != '#') {
            Line line = {.number = number};
            line.rest = at + strcspn(at, " \t");
            line.rest += strspn(line.rest, " \t");
            char *rest = strdup(line.rest);
            char *state;
            for (char *word = strtok_r(at, " \t", &state); word && line.count < WORDS;
                 word = strtok_r(NULL, " \t", &state)) {
                line.words[line.count++] = word;
            }
            line.rest = rest ? rest : "";
            bad = read_line(&line, settings);
            free(rest);
        }
        at = next;
    }
    free(copy);
    if (!bad && settings->loop_s > 0.0 && settings->waypoint_count == 0) {
        settings_problem("loop: there is no waypoint");
        bad = -1;
    }
    if (!bad && settings->loop_s > 0.0 &&
        settings->waypoints[settings->waypoint_count - 1].time_s > settings->loop_s) {
        settings_problem("loop: T is %g, before the last waypoint's %g", settings->loop_s,
                         settings->waypoints[settings->waypoint_count - 1].time_s);
        bad = -1;
    }
    if (bad) {
        drop(settings);
        return -1;
    }
    choose_noise(settings);
    return 0;
}

int settings_parse_file(Settings *settings, const char *path) {
    struct stat status;
    /* A pipe may never end, and nobody waits for its other end here. */
    int number = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    FILE *file = number < 0 ? NULL : fdopen(number, "rb");
    if (!file || fstat(number, &status)) {
        settings_problem("%.200s: %s", path, strerror(errno));
        if (file) {
            fclose(file);
        } else if (number >= 0) {
            close(number);
        }
        return -1;
    }
    if (!S_ISREG(status.st_mode) || status.st_size > MOST_SETTINGS_BYTES) {
        settings_problem("%.200s: it must be a file of at most %d bytes", path,
                         MOST_SETTINGS_BYTES);
        fclose(file);
        return -1;
    }
    char *text = malloc((size_t)status.st_size + 1);
    size_t size = text ? fread(text, 1, (size_t)status.st_size, file) : 0;
    int unread = ferror(file);
    fclose(file);
    if (!text || unread) {
        free(text);
        settings_problem("%.200s: it cannot be read", path);
        return -1;
    }
    text[size] = 0;
    int bad = settings_parse(settings, text);
    free(text);
    return bad;
}

int simConfigure(const char *text) {
    omni_enter();
    int busy = omni.device.initiated;
    omni_leave();
    if (busy) {
        settings_problem("a device is initialized: hdDisableDevice first");
        return -1;
    }
    Settings settings;
    int log_file;
    if (settings_parse(&settings, text)) {
        return -1;
    }
    if (log_open(&settings, &log_file)) {
        drop(&settings);
        return -1;
    }
    scheduler_stop();
    omni_enter();
    omni_power_on(&settings, log_file);
    omni.configured = 1;
    problem[0] = 0;
    omni_leave();
    return 0;
}

int simFault(const char *name, double value) {
    int fault = settings_fault(name);
    if (fault < 0) {
        settings_problem("there is no fault '%.40s'", name);
        return -1;
    }
    if (!fault_value_fits(fault, value)) {
        settings_problem("fault %s: the value is 0 or from %g to %g, not %g", name,
                         FAULTS[fault].least, FAULTS[fault].most, value);
        return -1;
    }
    omni_enter();
    omni_set_fault((Fault)fault, value);
    omni_leave();
    return 0;
}

/* --- the log --------------------------------------------------------------------------------- */

#define LOG_COLUMNS 31
#define LOG_ROWS 16384 /* that wait to be written: 16 s at 1 kHz; a power of two */
#define LOG_EVERY_S 0.05
#define LOG_LINE 1024  /* no line is longer */

static const char LOG_HEADER[] =
    "monotonic_s,tick,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,target_x_m,target_y_m,target_z_m,"
    "hand_x_n,hand_y_n,hand_z_n,commanded_x_n,commanded_y_n,commanded_z_n,"
    "delivered_x_n,delivered_y_n,delivered_z_n,delivered_j,hand_j,lost_j,kinetic_j,"
    "temperature,buttons,docked,gripped,amplifier,calibrated,period_s\n";

/* Ticks put rows at `put`, with omni_lock; the thread that has `writing` takes them at `taken`. The two
 * never wait for each other. `writing` may be taken with omni_lock, never the other way round. */
static struct {
    double (*rows)[LOG_COLUMNS];
    atomic_size_t put, taken, lost;
    int file;
    int broken;          /* it takes no more */
    pid_t process;
    double written_s;    /* virtual time of the newest writing */
    int threaded, stopping;
    pthread_t thread;
    pthread_mutex_t writing;
    pthread_cond_t stop;
} journal = {
    .file = -1,
    .writing = PTHREAD_MUTEX_INITIALIZER,
    .stop = PTHREAD_COND_INITIALIZER,
};

static void truth_of(SimTruth *truth);

void log_row(double time_s) {
    if (journal.file < 0) {
        return;
    }
    size_t put = atomic_load_explicit(&journal.put, memory_order_relaxed);
    if (put - atomic_load_explicit(&journal.taken, memory_order_acquire) == LOG_ROWS) {
        atomic_fetch_add_explicit(&journal.lost, 1, memory_order_relaxed);
        return;
    }
    SimTruth truth;
    truth_of(&truth);
    double *row = journal.rows[put % LOG_ROWS];
    double hottest = fmax(truth.temperature[0], fmax(truth.temperature[1], truth.temperature[2]));
    *row++ = time_s;
    *row++ = (double)truth.ticks;
    const double *const vectors[] = {truth.position_m,   truth.velocity_m_s, truth.hand_target_m,
                                     truth.hand_force_n, truth.commanded_n,  truth.delivered_n};
    for (size_t i = 0; i < sizeof vectors / sizeof *vectors; i++) {
        memcpy(row, vectors[i], 3 * sizeof *row);
        row += 3;
    }
    const double rest[] = {truth.delivered_j, truth.hand_j, truth.lost_j, truth.kinetic_j,
                           hottest, truth.buttons, truth.docked, truth.gripped, truth.amplifier,
                           truth.calibrated, omni.scheduler.period_s};
    memcpy(row, rest, sizeof rest);
    atomic_store_explicit(&journal.put, put + 1, memory_order_release);
}

/* With `writing`. A file that takes no more is left as it is. */
static void write_out(const char *text, size_t size) {
    while (size && !journal.broken) {
        ssize_t written = write(journal.file, text, size);
        if (written >= 0) {
            text += written;
            size -= (size_t)written;
        } else if (errno != EINTR) {
            fprintf(stderr, "libHD (simulated): the log: %s; it ends here\n", strerror(errno));
            journal.broken = 1;
        }
    }
}

/* With `writing`. */
static void write_rows(void) {
    static char text[64 * LOG_LINE];
    size_t size = 0;
    if (journal.file < 0 || journal.process != getpid()) {
        return;
    }
    locale_t before = uselocale(plain_locale());
    size_t taken = atomic_load_explicit(&journal.taken, memory_order_relaxed);
    size_t put = atomic_load_explicit(&journal.put, memory_order_acquire);
    for (; taken != put; taken++) {
        const double *row = journal.rows[taken % LOG_ROWS];
        for (int i = 0; i < LOG_COLUMNS; i++) {
            size += (size_t)sprintf(text + size, i ? ",%.9g" : "%.9f", row[i]);
        }
        text[size++] = '\n';
        atomic_store_explicit(&journal.taken, taken + 1, memory_order_release);
        if (size > sizeof text - LOG_LINE) {
            write_out(text, size);
            size = 0;
        }
    }
    write_out(text, size);
    uselocale(before);
    size_t lost = atomic_exchange(&journal.lost, 0);
    if (lost) {
        fprintf(stderr, "libHD (simulated): the log: %zu rows were lost, the disk is slow\n", lost);
    }
}

void log_flush(void) {
    pthread_mutex_lock(&journal.writing);
    write_rows();
    pthread_mutex_unlock(&journal.writing);
}

void log_keep_up(void) {
    omni_enter();
    double now_s = omni.scheduler.tick_s;
    omni_leave();
    pthread_mutex_lock(&journal.writing);
    if (now_s - journal.written_s >= LOG_EVERY_S) {
        journal.written_s = now_s;
        write_rows();
    }
    pthread_mutex_unlock(&journal.writing);
}

int log_open(const Settings *settings, int *file) {
    struct stat here, there;
    *file = -1;
    if (!settings->log[0]) {
        return 0;
    }
    /* Without waiting for a reader at the other end of a pipe. */
    int opened = open(settings->log, O_WRONLY | O_CREAT | O_CLOEXEC | O_NONBLOCK, 0644);
    if (opened < 0 || fstat(opened, &there)) {
        settings_problem("log: %.300s: %s", settings->log, strerror(errno));
        if (opened >= 0) {
            close(opened);
        }
        return -1;
    }
    (void)fcntl(opened, F_SETFL, fcntl(opened, F_GETFL) & ~O_NONBLOCK);
    int ours = journal.file >= 0 && !fstat(journal.file, &here) && here.st_ino == there.st_ino &&
               here.st_dev == there.st_dev;
    if (S_ISREG(there.st_mode) && !ours && flock(opened, LOCK_EX | LOCK_NB)) {
        settings_problem("log: %.300s: another program writes its log there", settings->log);
        close(opened);
        return -1;
    }
    *file = opened;
    return 0;
}

void log_take(int file) {
    pthread_mutex_lock(&journal.writing);
    write_rows();
    if (journal.file >= 0) {
        close(journal.file);
    }
    journal.file = -1;
    if (file >= 0 && !journal.rows) {
        journal.rows = calloc(LOG_ROWS, sizeof *journal.rows);
    }
    if (file >= 0 && !journal.rows) {
        fputs("libHD (simulated): the log: no memory\n", stderr);
        close(file);
    } else if (file >= 0) {
        (void)flock(file, LOCK_EX | LOCK_NB);
        (void)ftruncate(file, 0); /* what has no length needs none */
        journal.file = file;
        journal.broken = 0;
        journal.process = getpid();
        write_out(LOG_HEADER, sizeof LOG_HEADER - 1);
    }
    journal.written_s = 0.0;
    atomic_store(&journal.taken, atomic_load(&journal.put));
    pthread_mutex_unlock(&journal.writing);
}

static void *keep_writing(void *unused) {
    pthread_mutex_lock(&journal.writing);
    while (!journal.stopping) {
        struct timespec until;
        clock_gettime(CLOCK_REALTIME, &until);
        until.tv_nsec += (long)(LOG_EVERY_S * 1e9);
        until.tv_sec += until.tv_nsec / 1000000000;
        until.tv_nsec %= 1000000000;
        pthread_cond_timedwait(&journal.stop, &journal.writing, &until);
        write_rows();
    }
    pthread_mutex_unlock(&journal.writing);
    return unused;
}

void log_start(void) {
    sigset_t all, before;
    if (journal.file < 0 || journal.threaded) {
        return;
    }
    journal.stopping = 0;
    sigfillset(&all); /* the program's signals are for its own threads */
    pthread_sigmask(SIG_SETMASK, &all, &before);
    journal.threaded = !pthread_create(&journal.thread, NULL, keep_writing, NULL);
    pthread_sigmask(SIG_SETMASK, &before, NULL);
}

void log_stop(void) {
    if (!journal.threaded) {
        return;
    }
    pthread_mutex_lock(&journal.writing);
    journal.stopping = 1;
    pthread_cond_broadcast(&journal.stop);
    pthread_mutex_unlock(&journal.writing);
    pthread_join(journal.thread, NULL);
    journal.threaded = 0;
}

/* A program may end without hdStopScheduler, and its threads may run still. */
__attribute__((destructor)) static void write_log_at_exit(void) {
    struct timespec until;
    if (journal.file < 0 || journal.process != getpid()) {
        return;
    }
    clock_gettime(CLOCK_REALTIME, &until);
    until.tv_sec += 1;
    if (pthread_mutex_timedlock(&journal.writing, &until) == 0) {
        write_rows();
        pthread_mutex_unlock(&journal.writing);
    }
}

static void truth_of(SimTruth *truth) {
    const Arm *arm = &omni.arm;
    *truth = (SimTruth){
        .time_s = omni.scheduler.ticks ? omni.scheduler.tick_s : scheduler_now(),
        .ticks = omni.scheduler.ticks,
        .delivered_j = arm->delivered_j,
        .hand_j = arm->hand_j,
        .lost_j = arm->lost_j,
        .buttons = omni.hand.buttons,
        .docked = arm->locked,
        .gripped = !arm->locked && (omni.hand.gripped || omni.hand.docked),
        .amplifier = arm->amplifier,
        .calibrated = arm->calibrated,
        .script_done = omni.hand.done,
    };
    for (int i = 0; i < 3; i++) {
        truth->position_m[i] = arm->position_m[i];
        truth->velocity_m_s[i] = arm->velocity_m_s[i];
        truth->hand_target_m[i] = omni.hand.target_m[i];
        truth->hand_force_n[i] = arm->hand_force_n[i];
        truth->commanded_n[i] = arm->commanded_n[i];
        truth->delivered_n[i] = arm->delivered_n[i];
        truth->temperature[i] = arm->shown_temperature[i];
        truth->kinetic_j +=
            0.5 * omni.settings.mass_kg * arm->velocity_m_s[i] * arm->velocity_m_s[i];
    }
}

void simTruth(SimTruth *truth) {
    omni_enter();
    truth_of(truth);
    omni_leave();
}
