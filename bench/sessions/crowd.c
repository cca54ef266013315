/* Many robots and operators in one light process, with the answer time of each robot.

   crowd FOLDER TEMPLATE PLACES PRESSED RELEASED PORT...

   One robot for each port: it sends TEMPLATE, an EGM datagram in hexadecimal digits, to
   127.0.0.1:PORT every 4 ms, with its own counters and joints at PLACES (offsets in bytes: sequence
   number, tm, joints of feedBack, joints of planned, their clocks). It moves at once to the joints
   of the answer; its pose stays constant. Each robot has a SpaceMouse at FOLDER/N.mouse, a packet
   socket whose packets are HID reports; PRESSED and RELEASED are its button reports. The simulated
   operator holds the dead-man and moves in circles.

   READY SCHEDULING is printed when all sockets are open. `play COUNT WARM_UP SECONDS` on standard
   input starts the first COUNT robots; BEGIN is printed after the warm-up, and after SECONDS more
   the figures as one JSON object. The program ends at the end of its standard input.

   The kernel stamps answers on arrival, and they are read before the robot's next instant: playing
   costs little time, and the player's delays appear only in its own figures. */

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <netinet/in.h>
#include <poll.h>
#include <sched.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

enum {
    MOST = 128,
    AXES = 6,
    JOINT_STRIDE = 9, /* A tag, and a double. */
    DATAGRAM = 1400,
    FIRST_TM_MS = 1000000,
    FIRST_S = 1700000000,
    MAX_INSTANTS = 64, /* Instants of a robot that an answer may still be to. */
};

#define PERIOD_NS 4000000LL
#define REPORT_NS 8000000LL /* Of a wired SpaceMouse: halves of a motion take turns. */
#define LOOK_NS 50000000LL  /* How often it looks for programs that open a mouse. */
#define PRIORITY 20         /* Above the sessions': real robots need no processor of this computer. */

/* Device motion: at rest, dead-man pressed, circles, at rest, released; s since the start. */
#define HAND_S 6.0
#define PRESS_S 0.25
#define MOVE_S 0.4
#define STOP_S 5.8
#define RELEASE_S 5.9
#define CIRCLE_S 1.08
#define DEFLECTION 250 /* Of 350 counts. */

struct robot {
    int sock;
    double joints[AXES];
    uint32_t sequence;
    int64_t due_ns;
    int64_t sent_ns[MAX_INSTANTS];
    bool answered[MAX_INSTANTS];
};

struct mouse {
    int listener, program;
    int64_t due_ns, begun_ns;
    bool rotation_next, down;
};

static struct robot robots[MOST];
static struct mouse mice[MOST];
static int count;
static uint8_t template[DATAGRAM], pressed[16], released[16];
static size_t template_bytes, pressed_bytes, released_bytes;
static int at_sequence, at_tm, at_measured, at_planned, at_measured_clock, at_planned_clock;
static double start[AXES];

static struct {
    bool on;
    int32_t *answers_ns;
    size_t answers, room;
    int64_t sent, missed, moved, skipped;
    int64_t missed_of[MOST];
    int32_t *late_ns;
    size_t lates, late_room;
} figures;

static void fail(const char *what) {
    fprintf(stderr, "crowd: %s: %s\n", what, strerror(errno));
    exit(1);
}

static int64_t now_ns(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static size_t from_hex(const char *text, uint8_t *to, size_t room) {
    size_t bytes = strlen(text) / 2;
    if (bytes > room) {
        errno = EMSGSIZE;
        fail("hexadecimal digits");
    }
    for (size_t i = 0; i < bytes; i++) {
        unsigned byte;
        sscanf(text + 2 * i, "%2x", &byte);
        to[i] = (uint8_t)byte;
    }
    return bytes;
}

/* Write a varint into the bytes reserved for it in the template. */
static void put_number(uint8_t *to, int bytes, uint32_t value) {
    for (int i = 0; i < bytes; i++) {
        to[i] = (uint8_t)((value & 0x7f) | (i < bytes - 1 ? 0x80 : 0));
        value >>= 7;
    }
}

/* Seconds, a tag, and microseconds. */
static void put_clock(uint8_t *to, uint32_t ms) {
    put_number(to, 5, FIRST_S + ms / 1000);
    put_number(to + 6, 3, ms % 1000 * 1000);
}

static bool get_number(const uint8_t **from, const uint8_t *end, uint64_t *value) {
    *value = 0;
    for (int shift = 0; *from < end && shift < 64; shift += 7) {
        uint8_t byte = *(*from)++;
        *value |= (uint64_t)(byte & 0x7f) << shift;
        if (!(byte & 0x80))
            return true;
    }
    return false;
}

/* The next field of a protobuf message: its number, and its bytes or its value. */
static int next_field(const uint8_t **from, const uint8_t *end, const uint8_t **bytes,
                      uint64_t *value) {
    uint64_t tag;
    if (*from >= end || !get_number(from, end, &tag))
        return 0;
    switch (tag & 7) {
    case 0:
        return get_number(from, end, value) ? (int)(tag >> 3) : 0;
    case 1:
        *value = 8;
        break;
    case 2:
        if (!get_number(from, end, value))
            return 0;
        break;
    case 5:
        *value = 4;
        break;
    default:
        return 0;
    }
    if (*value > (uint64_t)(end - *from))
        return 0;
    *bytes = *from;
    *from += *value;
    return (int)(tag >> 3);
}

/* An EgmSensor: the tm of its header, repeated from the state, and planned joints, deg. */
static bool decode(const uint8_t *data, size_t size, uint32_t *tm, double *joints) {
    const uint8_t *end = data + size, *part = NULL, *inner = NULL, *deepest = NULL;
    uint64_t value;
    bool has_tm = false;
    int axis = 0, field;
    while ((field = next_field(&data, end, &part, &value)) != 0) {
        const uint8_t *part_end = part + value;
        if (field == 1) {
            while ((field = next_field(&part, part_end, &inner, &value)) != 0)
                if (field == 2) {
                    *tm = (uint32_t)value;
                    has_tm = true;
                }
        } else if (field == 2) {
            while ((field = next_field(&part, part_end, &inner, &value)) != 0) {
                const uint8_t *inner_end = inner + value;
                if (field != 1)
                    continue;
                while (axis < AXES && next_field(&inner, inner_end, &deepest, &value) == 1 &&
                       value == 8)
                    memcpy(&joints[axis++], deepest, 8);
            }
        }
    }
    return has_tm && axis == AXES;
}

static void add(int32_t **values, size_t *used, size_t *room, int64_t value) {
    if (*used == *room) {
        *room = *room ? 2 * *room : 1 << 16;
        *values = realloc(*values, *room * sizeof **values);
        if (*values == NULL)
            fail("memory");
    }
    (*values)[(*used)++] = (int32_t)(value > INT32_MAX ? INT32_MAX : value);
}

static void read_answers(struct robot *robot) {
    uint8_t data[DATAGRAM], control[128];
    for (;;) {
        struct iovec part = {data, sizeof data};
        struct msghdr message = {.msg_iov = &part, .msg_iovlen = 1, .msg_control = control,
                                 .msg_controllen = sizeof control};
        ssize_t size = recvmsg(robot->sock, &message, MSG_DONTWAIT);
        if (size < 0) {
            if (errno == ECONNREFUSED)
                continue; /* Nobody listens yet. */
            return;
        }
        double joints[AXES];
        uint32_t tm = 0;
        if (!decode(data, (size_t)size, &tm, joints))
            continue;
        uint32_t sequence = (tm - FIRST_TM_MS) / 4, back = robot->sequence - sequence;
        if (back == 0 || back > MAX_INSTANTS || robot->answered[sequence % MAX_INSTANTS])
            continue;
        struct cmsghdr *stamp = CMSG_FIRSTHDR(&message);
        if (stamp == NULL || stamp->cmsg_type != SO_TIMESTAMPNS)
            continue;
        struct timespec t;
        memcpy(&t, CMSG_DATA(stamp), sizeof t);
        int64_t arrived_ns = t.tv_sec * 1000000000LL + t.tv_nsec;
        robot->answered[sequence % MAX_INSTANTS] = true;
        if (figures.on) {
            add(&figures.answers_ns, &figures.answers, &figures.room,
                arrived_ns - robot->sent_ns[sequence % MAX_INSTANTS]);
            figures.moved += memcmp(robot->joints, joints, sizeof joints) != 0;
        }
        memcpy(robot->joints, joints, sizeof joints);
    }
}

static void instant(int index, int64_t late_ns) {
    struct robot *robot = &robots[index];
    read_answers(robot);
    if (figures.on) {
        figures.sent++;
        add(&figures.late_ns, &figures.lates, &figures.late_room, late_ns);
        if (!robot->answered[(robot->sequence - 1) % MAX_INSTANTS]) {
            figures.missed++;
            figures.missed_of[index]++;
        }
    }
    put_number(template + at_sequence, 5, robot->sequence);
    put_number(template + at_tm, 5, FIRST_TM_MS + 4 * robot->sequence);
    put_clock(template + at_measured_clock, 4 * robot->sequence);
    put_clock(template + at_planned_clock, 4 * robot->sequence);
    for (int axis = 0; axis < AXES; axis++) {
        memcpy(template + at_measured + JOINT_STRIDE * axis, &robot->joints[axis], 8);
        memcpy(template + at_planned + JOINT_STRIDE * axis, &robot->joints[axis], 8);
    }
    robot->answered[robot->sequence % MAX_INSTANTS] = false;
    robot->sent_ns[robot->sequence % MAX_INSTANTS] = now_ns(CLOCK_REALTIME);
    robot->sequence++;
    send(robot->sock, template, template_bytes, MSG_DONTWAIT);
}

static void say(struct mouse *mouse, const uint8_t *report, size_t bytes) {
    if (mouse->program >= 0)
        send(mouse->program, report, bytes, MSG_DONTWAIT | MSG_NOSIGNAL);
}

static void report(struct mouse *mouse, int64_t at_ns) {
    uint8_t data[64];
    if (mouse->program < 0)
        return;
    while (recv(mouse->program, data, sizeof data, MSG_DONTWAIT) > 0)
        ; /* Its light. */
    double s = fmod(1e-9 * (double)(at_ns - mouse->begun_ns), HAND_S);
    bool down = s >= PRESS_S && s < RELEASE_S, moves = s >= MOVE_S && s < STOP_S;
    if (down != mouse->down) {
        mouse->down = down;
        say(mouse, down ? pressed : released, down ? pressed_bytes : released_bytes);
    }
    double angle = 2.0 * M_PI * (s - MOVE_S) / CIRCLE_S;
    int16_t values[3] = {0, 0, 0};
    if (moves) {
        values[0] = (int16_t)(DEFLECTION * sin(angle));
        values[mouse->rotation_next ? 2 : 1] = (int16_t)(DEFLECTION * cos(angle));
    }
    data[0] = mouse->rotation_next ? 2 : 1;
    memcpy(data + 1, values, sizeof values);
    say(mouse, data, 1 + sizeof values);
    mouse->rotation_next = !mouse->rotation_next;
}

/* Accept programs at the mice; forget those that have closed the connection. */
static void meet(void) {
    for (int i = 0; i < count; i++) {
        struct mouse *mouse = &mice[i];
        uint8_t data;
        if (mouse->program >= 0 && recv(mouse->program, &data, 1, MSG_PEEK | MSG_DONTWAIT) == 0) {
            close(mouse->program);
            mouse->program = -1;
        }
        int program = accept4(mouse->listener, NULL, NULL, SOCK_CLOEXEC);
        if (program < 0)
            continue;
        if (mouse->program >= 0)
            close(mouse->program);
        mouse->program = program;
    }
}

static void play(int number, double warm_up_s, double seconds) {
    int64_t begin_ns = now_ns(CLOCK_MONOTONIC) + 10000000;
    int64_t measure_ns = begin_ns + (int64_t)(1e9 * warm_up_s);
    int64_t end_ns = measure_ns + (int64_t)(1e9 * seconds), look_ns = begin_ns;
    for (int i = 0; i < number; i++) {
        /* Separate robots have no common clock: spread their phases evenly, in shuffled order. */
        int64_t shift_ns = (int64_t)(fmod(0.6180339887 * i, 1.0) * PERIOD_NS);
        struct robot *robot = &robots[i];
        read_answers(robot);
        memcpy(robot->joints, start, sizeof start);
        memset(robot->answered, 0, sizeof robot->answered);
        robot->sequence = 1;
        robot->answered[0] = true;
        robot->due_ns = begin_ns + shift_ns;
        struct mouse *mouse = &mice[i];
        mouse->begun_ns = begin_ns + 37 * shift_ns;
        mouse->due_ns = mouse->begun_ns + shift_ns;
        mouse->rotation_next = false;
    }
    memset(&figures, 0, sizeof figures);
    for (;;) {
        int64_t due_ns = end_ns;
        for (int i = 0; i < number; i++) {
            due_ns = robots[i].due_ns < due_ns ? robots[i].due_ns : due_ns;
            due_ns = mice[i].due_ns < due_ns ? mice[i].due_ns : due_ns;
        }
        struct timespec t = {due_ns / 1000000000LL, due_ns % 1000000000LL};
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR)
            ;
        int64_t now = now_ns(CLOCK_MONOTONIC);
        if (now >= end_ns)
            break;
        if (!figures.on && now >= measure_ns) {
            puts("BEGIN");
            fflush(stdout);
            figures.on = true;
        }
        for (int i = 0; i < number; i++) {
            struct robot *robot = &robots[i];
            if (now >= robot->due_ns) {
                instant(i, now - robot->due_ns);
                robot->due_ns += PERIOD_NS;
                for (; robot->due_ns <= now; robot->due_ns += PERIOD_NS)
                    figures.skipped += figures.on;
            }
            struct mouse *mouse = &mice[i];
            if (now >= mouse->due_ns) {
                report(mouse, now);
                while (mouse->due_ns <= now)
                    mouse->due_ns += REPORT_NS;
            }
        }
        if (now >= look_ns) {
            look_ns = now + LOOK_NS;
            meet();
        }
    }
    for (int i = 0; i < number; i++) {
        say(&mice[i], released, released_bytes);
        mice[i].down = false;
    }
}

static int by_value(const void *a, const void *b) {
    int32_t x = *(const int32_t *)a, y = *(const int32_t *)b;
    return (x > y) - (x < y);
}

/* The quantile of sorted values, s. */
static double quantile(const int32_t *values, size_t used, double share) {
    size_t at = (size_t)(share * (double)used);
    return used == 0 ? 0.0 : 1e-9 * values[at < used ? at : used - 1];
}

static void tell(void) {
    int64_t worst = 0;
    for (int i = 0; i < count; i++)
        worst = figures.missed_of[i] > worst ? figures.missed_of[i] : worst;
    qsort(figures.answers_ns, figures.answers, sizeof *figures.answers_ns, by_value);
    qsort(figures.late_ns, figures.lates, sizeof *figures.late_ns, by_value);
    printf("{\"sent\": %lld, \"missed\": %lld, \"worst\": %lld, \"moved\": %lld, \"skipped\": %lld, "
           "\"p50_s\": %.7f, \"p99_s\": %.7f, \"late_p99_s\": %.7f, \"late_max_s\": %.7f}\n",
           (long long)figures.sent, (long long)figures.missed, (long long)worst,
           (long long)figures.moved, (long long)figures.skipped,
           quantile(figures.answers_ns, figures.answers, 0.5),
           quantile(figures.answers_ns, figures.answers, 0.99),
           quantile(figures.late_ns, figures.lates, 0.99),
           quantile(figures.late_ns, figures.lates, 1.0));
    fflush(stdout);
    free(figures.answers_ns);
    free(figures.late_ns);
    memset(&figures, 0, sizeof figures);
}

static void open_robot(struct robot *robot, int port) {
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port),
                             .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    int on = 1;
    robot->sock = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (robot->sock < 0 || connect(robot->sock, (struct sockaddr *)&to, sizeof to) ||
        setsockopt(robot->sock, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on))
        fail("a robot's socket");
}

static void open_mouse(struct mouse *mouse, const char *folder, int number) {
    struct sockaddr_un at = {.sun_family = AF_UNIX};
    snprintf(at.sun_path, sizeof at.sun_path, "%s/%d.mouse", folder, number);
    mouse->program = -1;
    mouse->listener = socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (mouse->listener < 0 || bind(mouse->listener, (struct sockaddr *)&at, sizeof at) ||
        listen(mouse->listener, 8))
        fail(at.sun_path);
}

static const char *ask_for_real_time(void) {
    struct sched_param priority = {.sched_priority = PRIORITY};
    prctl(PR_SET_TIMERSLACK, 1);
    if (sched_setscheduler(0, SCHED_FIFO, &priority) == 0)
        return "real time";
    if (setpriority(PRIO_PROCESS, 0, -20) == 0)
        return "raised priority";
    return "ordinary";
}

int main(int argc, char **argv) {
    count = argc - 6;
    if (count < 1 || count > MOST ||
        sscanf(argv[3], "%d,%d,%d,%d,%d,%d", &at_sequence, &at_tm, &at_measured, &at_planned,
               &at_measured_clock, &at_planned_clock) != 6) {
        fprintf(stderr, "crowd FOLDER TEMPLATE PLACES PRESSED RELEASED PORT...\n");
        return 2;
    }
    template_bytes = from_hex(argv[2], template, sizeof template);
    pressed_bytes = from_hex(argv[4], pressed, sizeof pressed);
    released_bytes = from_hex(argv[5], released, sizeof released);
    for (int axis = 0; axis < AXES; axis++)
        memcpy(&start[axis], template + at_measured + JOINT_STRIDE * axis, 8);
    for (int i = 0; i < count; i++) {
        open_robot(&robots[i], atoi(argv[6 + i]));
        open_mouse(&mice[i], argv[1], i);
    }
    printf("READY %s\n", ask_for_real_time());
    fflush(stdout);
    for (;;) {
        struct pollfd asked = {.fd = 0, .events = POLLIN};
        if (poll(&asked, 1, (int)(LOOK_NS / 1000000)) > 0) {
            char line[128];
            int number;
            double warm_up_s, seconds;
            ssize_t size = read(0, line, sizeof line - 1);
            if (size <= 0)
                return 0;
            line[size] = 0;
            if (sscanf(line, "play %d %lf %lf", &number, &warm_up_s, &seconds) != 3 || number < 1 ||
                number > count) {
                fprintf(stderr, "crowd: not known: %s", line);
                return 2;
            }
            play(number, warm_up_s, seconds);
            tell();
        }
        meet();
    }
}
