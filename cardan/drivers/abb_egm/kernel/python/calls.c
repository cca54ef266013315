/*
 * What cardan/drivers/abb_egm/compiled.py calls in every cycle: functions that take Python's objects
 * and give them, since to go through ctypes costs more than all that is done here. Each has a tuple
 * as `self`: the memory of its structures and the types and constants of which it makes results.
 *
 * Each gives None, and nothing is changed, for what is unusual.
 */
#include <stdbool.h>
#include <string.h>

#include "answer.h"
#include "objects.h"
#include "pose.h"
#include "take.h"

/* 40 values of 8 bytes, a digital one, and what is around them, with room. */
#define SUFFIX_MAX 600

/* Places in RobotState. */
enum { STAMP, LINK, SESSION, SEQUENCE, PERIOD, JOINTS, EXTERNAL, POSE, REASON, WRENCH, UTILIZATION,
       CLOCK, ALARM, VELOCITIES, TORQUES, FIELDS };

/* -- answers ------------------------------------------------------------------------------------ */

/* Places in the `self` of those who answer. */
enum { CYCLE, ANSWER, TARGET_TYPE, SPEED_TYPE, HOLD_TYPE, FRAME, NOTHING };

/* What every answer is made of besides the command. */
typedef struct {
    EgmCycle *cycle;
    PyObject *state;
    double dt_s, now_s;
    uint32_t seqno, tm_ms;
    char *suffix;
    Py_ssize_t suffix_size;
} Due;

/* Given the command, the time, the state that is answered and the end of the message. */
static bool due(PyObject *self, PyObject *const *given, Py_ssize_t count, Due *into)
{
    if (count != 4) {
        PyErr_SetString(PyExc_TypeError, "an answer takes 4 arguments");
        return false;
    }
    if (!is_tuple(given[2], FIELDS))
        return false;
    EgmCycle *cycle = into->cycle = memory(self, CYCLE);
    into->state = given[2];
    into->now_s = PyFloat_AsDouble(given[1]);
    double stamp_s = PyFloat_AsDouble(PyTuple_GetItem(into->state, STAMP));
    if (PyTuple_GetItem(into->state, REASON) != PyTuple_GetItem(self, NOTHING) ||
        PyBytes_AsStringAndSize(given[3], &into->suffix, &into->suffix_size) || PyErr_Occurred() ||
        into->suffix_size > SUFFIX_MAX)
        return false;
    into->dt_s = egm_answer_period(cycle, stamp_s, into->now_s);
    into->seqno = cycle->out_seqno;
    into->tm_ms = egm_answer_time(cycle, into->now_s);
    return into->dt_s > 0.0;
}

/* The message of `size` bytes as an object, noted in the session. */
static PyObject *told(const Due *due, int32_t size, const uint8_t *reply, int32_t moving)
{
    char whole[EGM_REPLY_MAX + SUFFIX_MAX];
    if (!size)
        return held(NONE);
    memcpy(whole, reply, (size_t)size);
    memcpy(whole + size, due->suffix, (size_t)due->suffix_size);
    egm_answered(due->cycle, moving, due->now_s);
    return PyBytes_FromStringAndSize(whole, size + due->suffix_size);
}

/* A target (position, speed or None, external axes, ...) for the arm alone. */
static bool is_target(PyObject *self, PyObject *command)
{
    return is_kind(self, TARGET_TYPE, command, 4) && is_tuple(PyTuple_GetItem(command, 2), 0);
}

/* (command, now_s, state, suffix): the message */
static PyObject *answer_joints(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    Due d;
    if (!due(self, given, count, &d))
        return refused();
    EgmAnswer *answer = memory(self, ANSWER);
    PyObject *command = given[0];
    int32_t size = 0;
    if (!answer->relocates && is_target(self, command)) {
        PyObject *speeds = PyTuple_GetItem(command, 1);
        if (floats(PyTuple_GetItem(command, 0), EGM_JOINTS, answer->positions) &&
            (speeds == NONE || floats(speeds, EGM_JOINTS, answer->velocities)))
            size = egm_answer(answer, speeds != NONE, d.dt_s, d.seqno, d.tm_ms);
    } else if (!answer->relocates ||
               floats(PyTuple_GetItem(d.state, JOINTS), EGM_JOINTS, answer->measured)) {
        if (is_kind(self, HOLD_TYPE, command, 1))
            size = egm_answer_hold(answer, d.dt_s, d.seqno, d.tm_ms);
        else if (answer->relocates && is_kind(self, SPEED_TYPE, command, 2) &&
                 floats(PyTuple_GetItem(command, 0), EGM_JOINTS, answer->velocities))
            size = egm_answer_speed(answer, d.dt_s, d.seqno, d.tm_ms);
    }
    return told(&d, size, answer->reply, answer->moving);
}

static bool pose(PyObject *self, PyObject *object, double *position, double *orientation)
{
    return is_tuple(object, 3) && PyTuple_GetItem(object, 2) == PyTuple_GetItem(self, FRAME) &&
           floats(PyTuple_GetItem(object, 0), 3, position) &&
           floats(PyTuple_GetItem(object, 1), 4, orientation);
}

static bool twist(PyObject *self, PyObject *object, EgmPoseAnswer *into)
{
    return is_tuple(object, 3) && PyTuple_GetItem(object, 2) == PyTuple_GetItem(self, FRAME) &&
           floats(PyTuple_GetItem(object, 0), 3, into->linear) &&
           floats(PyTuple_GetItem(object, 1), 3, into->angular);
}

/* The same in pose mode. */
static PyObject *answer_pose(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    Due d;
    if (!due(self, given, count, &d))
        return refused();
    EgmPoseAnswer *answer = memory(self, ANSWER);
    PyObject *command = given[0];
    int32_t size = 0;
    if (!answer->relocates && is_target(self, command)) {
        PyObject *speeds = PyTuple_GetItem(command, 1);
        if (pose(self, PyTuple_GetItem(command, 0), answer->position, answer->orientation) &&
            (speeds == NONE || twist(self, speeds, answer)))
            size = egm_pose_answer(answer, speeds != NONE, d.dt_s, d.seqno, d.tm_ms);
    } else if (!answer->relocates ||
               pose(self, PyTuple_GetItem(d.state, POSE), answer->measured_position,
                    answer->measured_orientation)) {
        if (is_kind(self, HOLD_TYPE, command, 1))
            size = egm_pose_answer_hold(answer, d.dt_s, d.seqno, d.tm_ms);
        else if (answer->relocates && is_kind(self, SPEED_TYPE, command, 2) &&
                 twist(self, PyTuple_GetItem(command, 0), answer))
            size = egm_pose_answer_speed(answer, d.dt_s, d.seqno, d.tm_ms);
    }
    return told(&d, size, answer->reply, answer->moving);
}

/* -- reception ---------------------------------------------------------------------------------- */

/* Places in the `self` of the one who takes; CYCLE is first again. */
enum { READER = 1, STATE_TYPE, POSE_TYPE, VECTOR_TYPE, QUATERNION_TYPE, WRENCH_TYPE, LIVE, BASE,
       FORCE_FRAME, NO_AXES, NO_REASON };

static PyObject *vector(PyObject *self, const double *values)
{
    return named(PyTuple_GetItem(self, VECTOR_TYPE), floats_tuple(values, 3));
}

static PyObject *three(PyObject *self, int type, PyObject *a, PyObject *b, int frame)
{
    PyObject *items[] = {a, b, held(PyTuple_GetItem(self, frame))};
    return named(PyTuple_GetItem(self, type), tuple_of(3, items));
}

/* Where the arm was, and when, of a RobotState in which commands acted. */
static bool before(PyObject *self, PyObject *state, EgmCycle *into)
{
    if (PyTuple_GetItem(state, REASON) != PyTuple_GetItem(self, NO_REASON))
        return false;
    PyObject *pose = PyTuple_GetItem(state, POSE);
    if (!is_tuple(pose, 3) || !floats(PyTuple_GetItem(state, JOINTS), 6, into->joints) ||
        !floats(PyTuple_GetItem(pose, 0), 3, into->position) ||
        !floats(PyTuple_GetItem(pose, 1), 4, into->orientation))
        return false;
    into->last_s = PyFloat_AsDouble(PyTuple_GetItem(state, STAMP));
    into->seqno = (uint32_t)PyLong_AsLongLong(PyTuple_GetItem(state, SEQUENCE));
    return !PyErr_Occurred();
}

static PyObject *wrench(PyObject *self, const EgmReader *reader, const EgmLayout *layout)
{
    if (layout->forces != EGM_FORCES)
        return held(NONE);
    return three(self, WRENCH_TYPE, vector(self, reader->forces), vector(self, reader->forces + 3),
                 FORCE_FRAME);
}

/* (data, now_s, the state before): the new state, the data again, and the jitter, s */
static PyObject *take(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    EgmCycle *cycle = memory(self, CYCLE);
    EgmReader *reader = memory(self, READER);
    char *data;
    Py_ssize_t size;
    if (count != 3) {
        PyErr_SetString(PyExc_TypeError, "taking a datagram takes 3 arguments");
        return NULL;
    }
    if (PyBytes_AsStringAndSize(given[0], &data, &size))
        return NULL;
    double now_s = PyFloat_AsDouble(given[1]);
    if (!is_tuple(given[2], FIELDS) || (!cycle->known && !before(self, given[2], cycle)) ||
        !egm_take(cycle, reader, (const uint8_t *)data, size, now_s))
        return refused();
    const EgmLayout *layout = &reader->layouts[cycle->layout];
    PyObject *turned = named(PyTuple_GetItem(self, QUATERNION_TYPE), floats_tuple(cycle->turned, 4));
    PyObject *no_axes = PyTuple_GetItem(self, NO_AXES), *nothing = PyTuple_GetItem(self, NO_REASON);
    PyObject *fields[FIELDS] = {
        [STAMP] = held(given[1]),
        [LINK] = held(PyTuple_GetItem(self, LIVE)),
        [SESSION] = held(PyTuple_GetItem(given[2], SESSION)),
        [SEQUENCE] = PyLong_FromLongLong(reader->seqno),
        [PERIOD] = PyFloat_FromDouble(cycle->last_step_s),
        [JOINTS] = floats_tuple(reader->joints, 6),
        [EXTERNAL] = held(no_axes),
        [POSE] = three(self, POSE_TYPE, vector(self, reader->position), turned, BASE),
        [REASON] = held(nothing),
        [WRENCH] = wrench(self, reader, layout),
        [UTILIZATION] = layout->has_rate ? PyFloat_FromDouble(0.01 * reader->rate) : held(NONE),
        [CLOCK] = PyFloat_FromDouble(1e-6 * (double)reader->time_us),
        [ALARM] = held(nothing),
        [VELOCITIES] = held(no_axes),
        [TORQUES] = held(no_axes),
    };
    PyObject *found[] = {named(PyTuple_GetItem(self, STATE_TYPE), tuple_of(FIELDS, fields)),
                         held(given[0]), PyFloat_FromDouble(cycle->jitter_s)};
    return tuple_of(3, found);
}

#define CALL(name)                                                                                 \
    EGM_API PyMethodDef egm_call_##name = {#name, name, METH_FASTCALL, NULL};
CALL(answer_joints)
CALL(answer_pose)
CALL(take)
