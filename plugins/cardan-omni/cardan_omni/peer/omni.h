/* Declarations shared by the parts of the simulated libHD. All of its state is in one struct, so
 * that simConfigure resets all of it. SI units; device frame of HDAPI (x right, y up, z to the
 * operator). HDAPI's mm and mN·m exist in api.c alone. */
#ifndef CARDAN_OMNI_OMNI_H
#define CARDAN_OMNI_OMNI_H

#include <pthread.h>
#include <stddef.h>
#include <stdint.h>

#include "hdapi.h"
#include "sim.h"

#define HD_API __attribute__((visibility("default")))

/* --- settings.c ------------------------------------------------------------------------------ */

typedef enum {
    FAULT_COMM_ERROR,
    FAULT_UNPLUG,
    FAULT_LATE_TICK,
    FAULT_OVERRUN,
    FAULT_WARM_MOTORS,
    FAULT_OVER_FORCE,
    FAULT_UNCALIBRATED,
    FAULT_BUTTON_BOUNCE,
    FAULT_STUCK_ENCODER,
    FAULT_JITTER,
    FAULT_SLOW_TICKS,
    FAULT_INIT_FAILS,
    FAULT_NO_LICENSE,
    FAULT_DEAD_SCHEDULER,
    FAULT_COUNT
} Fault;

typedef struct {
    double time_s;
    double position_m[3];
    double turn_rad[3];
    double push_n[3];
    double stiffness_n_m[3];
    int gripped;
    int buttons;
    int docked;
} Waypoint;

typedef struct {
    Fault fault;
    double value;
    double from_s;
} PlannedFault;

#define PLANNED_FAULTS 64
#define TEXT_SIZE 64
#define PATH_SIZE 4096

typedef struct {
    int virtual_clock;
    uint64_t seed;
    int rate_hz;
    int calibrated;
    double mass_kg;
    double friction_n;
    double viscous_n_s_m;
    double droop_n;
    double hand_mass_kg;
    double hand_damping_n_s_m;
    double hand_stiffness_n_m;
    int gripped;
    double thermal_s;
    double gimbal_scale[3];
    double gimbal_offset_rad[3];
    double gimbal_noise_lsb;  /* peak to peak; negative: as the model has it */
    Waypoint *waypoints;
    size_t waypoint_count;
    double loop_s;
    PlannedFault faults[PLANNED_FAULTS];
    int fault_count;
    char model[TEXT_SIZE];
    char serial[TEXT_SIZE];
    char device[TEXT_SIZE];
    char log[PATH_SIZE];
} Settings;

/* The newest complaint, for simProblem. */
void settings_problem(const char *format, ...) __attribute__((format(printf, 1, 2)));
/* 0, or -1 and a problem; then `settings` owns nothing. */
int settings_parse(Settings *settings, const char *text);
int settings_parse_file(Settings *settings, const char *path);
/* -1 for a name there is not. */
int settings_fault(const char *name);

/* --- hand.c ---------------------------------------------------------------------------------- */

typedef struct {
    int scripted;
    size_t segment;           /* the waypoint before now */
    double target_m[3];
    double target_velocity_m_s[3];
    double turn_rad[3];       /* where the hand wants the stylus to point */
    double push_n[3];
    double stiffness_n_m[3];
    int gripped;
    int buttons;
    int docked;               /* the hand puts the stylus into the inkwell, or leaves it there */
    int carrying;             /* on the way there */
    double carried_m[3];
    int done;
} Hand;

void hand_power_on(void);
/* Advance the hand to this time of the script, `dt_s` after the last call. */
void hand_advance(double script_s, double dt_s);

/* --- arm.c ----------------------------------------------------------------------------------- */

/* Values of the sensors in a tick, as the library reads them. */
typedef struct {
    double position_m[3];
    double velocity_m_s[3];
    double joints_rad[3];
    double gimbal_rad[3];     /* with the unit's scale and offset */
    double gimbal_rad_s[3];
    double rotation[3][3];    /* columns: the stylus' axes */
    long encoders[6];
    int buttons;
    int docked;
} Sample;

typedef struct {
    double position_m[3];
    double velocity_m_s[3];
    double turn_rad[3];
    double gimbal_rad[3];
    int locked;               /* in the inkwell */
    double hand_force_n[3];
    double world_push_n[3];

    /* The motors */
    double commanded_n[3];
    int torque_mode;          /* the last frame carried joint torques */
    double output_n[3];       /* held to the next frame */
    double output_n_m[3];     /* the same in torque mode, and as the tip then feels it: */
    double delivered_n[3];
    double command_age_s;
    double previous_n[3];     /* of the frame before, for the impulse limit */
    double previous_s;        /* when, by scheduler_now */
    int amplifier;
    double off_until_s;       /* after an EXCEEDED error, on the clock elapsed_s */
    double ramp_n;            /* what the ramp lets through now */
    double temperature[3];    /* as the currents made it */
    double shown_temperature[3];
    int warm;
    double warm_told_s;
    int too_fast;
    double over_force_s;      /* when the fault strikes next */

    double delivered_j, hand_j, lost_j;

    /* The sensors */
    int calibrated;
    double encoder_zero_rad[3]; /* the joints' true angles where the encoders are 0 */
    long correction[3];       /* of the encoders, by calibration */
    long stuck_count;
    int stuck_joint;          /* 0: none */
    int button_level, button_shown;
    double bounce_until_s;
    double last_position_m[3];
    double velocity_stage[2][3];
    double last_gimbal_rad[3];
    double gimbal_stage[2][3];
    double gimbal_noise[3];   /* of this tick's readings, LSB */
    Sample fresh;             /* taken in this tick */
    Sample ready;             /* one tick old: what the next frame reads */
} Arm;

#define OMNI_MAX_FORCE_N 3.3
#define OMNI_CONTINUOUS_FORCE_N 0.88
#define OMNI_FULL_SCALE_N_M 0.6   /* what the motors give at the end of the converter */

void arm_forward(const double joints_rad[3], double position_m[3]);
void arm_inverse(const double position_m[3], double joints_rad[3]);
void arm_jacobian(const double joints_rad[3], double jacobian_m[3][3]);
/* Joint torques to the force at the tip that they balance, and back. */
void arm_torque_to_force(const double joints_rad[3], const double torque_n_m[3], double force_n[3]);
void arm_force_to_torque(const double joints_rad[3], const double force_n[3], double torque_n_m[3]);
void arm_rotation(const double joints_rad[3], const double gimbal_rad[3], double rotation[3][3]);

void arm_power_on(void);
/* The world moves on, with the force that is out. */
void arm_advance(double dt_s);
/* Sensors, temperature, and what the library watches once per tick. */
void arm_tick(double dt_s);
void arm_sample_now(void);
/* A frame has ended with this command; raises what the limits find. */
void arm_command(const double force_n[3], const double torque_n_m[3], int torque_mode);
/* No frame in this tick, or no scheduler: nothing goes out. */
void arm_silence(void);
void arm_lose_calibration(void);
/* The inkwell is where it is now. */
void arm_calibrate(void);
/* A gimbal's angle (rad) by its converter's count. */
double arm_gimbal_of(long count);
int arm_connected(void);

/* --- scheduler.c ----------------------------------------------------------------------------- */

#define SCHEDULER_CALLBACKS 64

typedef struct {
    HDSchedulerHandle handle; /* 0: a free place */
    HDSchedulerCallback callback;
    void *user;
    HDushort priority;
    int synchronous;
    int running;
} Entry;

typedef struct {
    Entry entries[SCHEDULER_CALLBACKS];
    HDSchedulerHandle last_handle;
    int started;
    int stopping;
    int rate_hz;
    double grid_s;            /* where the tick ought to be */
    double tick_s;            /* where it was; on the library's clock */
    double held_up_s;         /* since then, in virtual time */
    uint64_t ticks;
    double mean_rate_hz;
    double period_s;
    int frame_by_synchronous; /* the frame of this tick was that of a synchronous callback */
} Scheduler;

double scheduler_now(void);
void scheduler_stop(void);

/* --- log ------------------------------------------------------------------------------------- */

/* A row with what is true now, at this time of the library's clock. Never waits for a disk. */
void log_row(double time_s);
/* Opens a file for rows: 0, or -1 and a problem; *file is -1 for settings without a log. */
int log_open(const Settings *settings, int *file);
/* Rows go there from now on; what was written to before is complete. */
void log_take(int file);
/* Writes what rows there are. Not in a tick of a thread. */
void log_flush(void);
/* In virtual time: writes when there is something to write. */
void log_keep_up(void);
/* A thread that writes, while the scheduler's has its ticks. */
void log_start(void);
void log_stop(void);

/* --- api.c ----------------------------------------------------------------------------------- */

typedef struct {
    Sample current, last;
    double force_n[3], torque_n_m[3], joint_torque_n_m[3], gimbal_torque_n_m[3];
    long dac[3];
    double last_force_n[3], last_torque_n_m[3], last_joint_torque_n_m[3], last_gimbal_torque_n_m[3];
    long last_dac[3];
    int force_set, joint_torque_set, dac_set, conflict;
    int depth;                /* frames open */
    int used;                 /* one was begun in this tick */
    int flushed;              /* one was ended in this tick */
} Frame;

enum {
    CAP_FORCE_OUTPUT,
    CAP_MAX_FORCE_CLAMPING,
    CAP_FORCE_RAMPING,
    CAP_SOFTWARE_FORCE_LIMIT,
    CAP_ONE_FRAME_LIMIT,
    CAP_SOFTWARE_VELOCITY_LIMIT,
    CAP_SOFTWARE_FORCE_IMPULSE_LIMIT,
    CAP_USER_STATUS_LIGHT,
    CAP_COUNT
};

#define ERROR_STACK 64

typedef struct {
    int initiated;
    HHD handle;
    HHD next_handle;
    int current;              /* made current, and not disabled since */
    int gone;                 /* unplugged since it was initiated */
    int licensed;
    int enabled[CAP_COUNT];
    double velocity_limit_m_s;
    double impulse_limit_n_ms;
    double ramping_n_s;
    int status_light;
    Frame frame;
    HDErrorInfo errors[ERROR_STACK];
    int error_count;
} Device;

void push_error(HDerror code, int internal);
void device_power_on(void);
/* The settings that CARDAN_OMNI names, unless there are some; -1 when they are no settings. */
int device_take_environment(void);
/* A frame left open is closed by the end of the tick. */
void device_end_of_tick(void);

/* --- the whole ------------------------------------------------------------------------------- */

typedef struct {
    Settings settings;
    int configured;           /* by simConfigure, or by the environment */
    double elapsed_s;         /* of the world: the script's clock */
    uint64_t random;
    uint64_t noise;           /* of the gimbal: a series of its own */
    double fault[FAULT_COUNT];
    int planned_done[PLANNED_FAULTS];
    Hand hand;
    Arm arm;
    Scheduler scheduler;
    Device device;
} Omni;

extern Omni omni;
/* Guards `omni`. Never held while a callback runs. */
extern pthread_mutex_t omni_lock;

void omni_enter(void);
void omni_leave(void);
/* As just powered on, with these settings, which it takes over, and their log. */
void omni_power_on(const Settings *settings, int log_file);
double omni_random(uint64_t *series); /* 0 <= r < 1 */
/* A fault begins, changes or (0) ends. */
void omni_set_fault(Fault fault, double value);
/* Faults whose time has come. */
void omni_plan(void);

#endif
