/*
 * What cardan/drivers/ur_rtde/compiled.py calls in every cycle. Each gives None, and nothing is
 * changed, for what is unusual.
 */
#include "cycle.h"
#include "objects.h"

#ifndef CARDAN_VERSION
#error "tools/native defines CARDAN_VERSION, the package's version"
#endif

const char *ur_version(void)
{
    return CARDAN_VERSION;
}

#define AT(type, field) offsetof(type, field)

/* Every field, in the order of cardan/drivers/ur_rtde/compiled.py. */
static const size_t LAYOUT[] = {
    sizeof(UrStates),
    AT(UrStates, largest_time_s), AT(UrStates, largest_position), AT(UrStates, largest_velocity),
    AT(UrStates, largest_scale), AT(UrStates, rate_hz), AT(UrStates, period_s),
    AT(UrStates, slack_s), AT(UrStates, pause_s), AT(UrStates, astray_rad), AT(UrStates, moves_in),
    AT(UrStates, robot_mode), AT(UrStates, runtime_state), AT(UrStates, report),
    AT(UrStates, token), AT(UrStates, head),
    sizeof(UrCommands),
    AT(UrCommands, limits.lower), AT(UrCommands, limits.upper),
    AT(UrCommands, limits.inner_lower), AT(UrCommands, limits.inner_upper),
    AT(UrCommands, limits.speed), AT(UrCommands, limits.acceleration),
    AT(UrCommands, largest_position), AT(UrCommands, largest_velocity),
    AT(UrCommands, work_off_s), AT(UrCommands, work_off_share), AT(UrCommands, recent_s),
    AT(UrCommands, speed_up_s), AT(UrCommands, slow_down_s), AT(UrCommands, nothing),
    AT(UrCommands, token), AT(UrCommands, order), AT(UrCommands, head),
};

size_t ur_layout(const size_t **values)
{
    *values = LAYOUT;
    return sizeof LAYOUT / sizeof *LAYOUT;
}

/* A float of `object` by the name at a place of `self`; false: it is none, or an exception. */
static bool get_number(PyObject *self, PyObject *object, int name, double *into)
{
    PyObject *found = PyObject_GetAttr(object, PyTuple_GetItem(self, name));
    if (!found)
        return false;
    bool good = type_of(found) == &PyFloat_Type;
    if (good)
        *into = PyFloat_AsDouble(found);
    Py_DecRef(found);
    return good;
}

/* It takes `value` over. */
static bool set(PyObject *self, PyObject *object, int name, PyObject *value)
{
    if (!value)
        return false;
    bool good = !PyObject_SetAttr(object, PyTuple_GetItem(self, name), value);
    Py_DecRef(value);
    return good;
}

/* -- states -------------------------------------------------------------------------------------- */

/* Places in the `self` of the one who takes; MEMORY is first in both. */
enum { MEMORY, CLOCK, PACKAGE_TYPE, CONTROLLER, LOCAL, ROSE, STILL, WAITED, BEST, END, CREDIT, TIME,
       ZERO };

static bool read_clock(PyObject *self, PyObject *object, UrClock *into)
{
    return get_number(self, object, CONTROLLER, &into->controller_s) &&
           get_number(self, object, LOCAL, &into->local_s) &&
           get_number(self, object, BEST, &into->best_s) &&
           get_number(self, object, END, &into->end_s) &&
           get_number(self, object, CREDIT, &into->credit_s) &&
           get_number(self, object, TIME, &into->time_s);
}

static bool write_clock(PyObject *self, PyObject *object, PyObject *now, const UrClock *clock)
{
    return set(self, object, CONTROLLER, PyFloat_FromDouble(clock->controller_s)) &&
           set(self, object, LOCAL, held(now)) && set(self, object, ROSE, held(now)) &&
           set(self, object, STILL, held(PyTuple_GetItem(self, ZERO))) &&
           set(self, object, WAITED, PyFloat_FromDouble(clock->waited_s)) &&
           set(self, object, CREDIT, PyFloat_FromDouble(clock->credit_s)) &&
           set(self, object, TIME, PyFloat_FromDouble(clock->time_s));
}

/* (data, now_s): the package, the slider, whether the program obeys, and the timestamp */
static PyObject *take(PyObject *self, PyObject *const *given, Py_ssize_t length)
{
    char *data;
    Py_ssize_t size;
    UrClock clock;
    UrState state;
    if (length != 2) {
        PyErr_SetString(PyExc_TypeError, "taking a state takes 2 arguments");
        return NULL;
    }
    if (PyBytes_AsStringAndSize(given[0], &data, &size))
        return NULL;
    PyObject *object = PyTuple_GetItem(self, CLOCK);
    double now_s = PyFloat_AsDouble(given[1]);
    if (PyErr_Occurred() || !read_clock(self, object, &clock) ||
        !ur_take(memory(self, MEMORY), (const uint8_t *)data, size, now_s, &clock, &state))
        return refused();
    if (!write_clock(self, object, given[1], &clock))
        return NULL;
    PyObject *timestamp = PyFloat_FromDouble(state.timestamp);
    if (!timestamp)
        return NULL;
    PyObject *fields[] = {
        held(timestamp),
        floats_tuple(state.joints[0], UR_JOINTS),
        floats_tuple(state.joints[1], UR_JOINTS),
        floats_tuple(state.joints[2], UR_JOINTS),
        floats_tuple(state.joints[3], UR_JOINTS),
        PyLong_FromLongLong(state.modes[0]),
        PyLong_FromLongLong(state.modes[1]),
        PyLong_FromLongLong(state.modes[2]),
        PyFloat_FromDouble(state.speed_scaling),
        PyFloat_FromDouble(state.target_speed_fraction),
        PyLong_FromLongLong(state.registers[0]),
        PyLong_FromLongLong(state.registers[1]),
        PyLong_FromLongLong(state.registers[2]),
    };
    PyObject *package = tuple_of(sizeof fields / sizeof *fields, fields);
    PyObject *found[] = {
        package ? named(PyTuple_GetItem(self, PACKAGE_TYPE), package) : NULL,
        PyFloat_FromDouble(state.slider),
        held(state.obeys ? &_Py_TrueStruct : &_Py_FalseStruct),
        timestamp,
    };
    return tuple_of(sizeof found / sizeof *found, found);
}

/* -- commands ------------------------------------------------------------------------------------ */

/* Places in the `self` of the one who answers. */
enum { LIMITER = 1, TARGET_TYPE, KIND, REFERENCE, VELOCITY, TARGET, LOST, INTERRUPTED, RESTED, FASTEST,
       OFFSET, RATE };

/* The list of floats that is an attribute of `object`, as an owned reference; NULL: it is none. */
static PyObject *list_of(PyObject *self, PyObject *object, int name, double *into)
{
    PyObject *list = PyObject_GetAttr(object, PyTuple_GetItem(self, name));
    for (int i = 0; list && i < UR_JOINTS; i++) {
        PyObject *item = PyList_GetItem(list, i);
        if (!item || type_of(item) != &PyFloat_Type) {
            Py_DecRef(list);
            return NULL;
        }
        into[i] = PyFloat_AsDouble(item);
    }
    return list;
}

static bool write_list(PyObject *list, const double *values)
{
    for (int i = 0; i < UR_JOINTS; i++) {
        PyObject *item = PyFloat_FromDouble(values[i]);
        if (!item || PyList_SetItem(list, i, item))
            return false;
    }
    return true;
}

/* The target of the command before; false: it is not one of floats. */
static bool read_target(PyObject *self, PyObject *object, UrReference *into)
{
    PyObject *target = PyObject_GetAttr(object, PyTuple_GetItem(self, TARGET));
    if (!target)
        return false;
    into->has_target = target != NONE;
    bool good = !into->has_target || floats(target, UR_JOINTS, into->target);
    Py_DecRef(target);
    return good;
}

static bool read_command(PyObject *self, PyObject *command, UrReference *into)
{
    if (!is_kind(self, TARGET_TYPE, command, 4) || !is_tuple(PyTuple_GetItem(command, 2), 0) ||
        PyTuple_GetItem(command, 3) != PyTuple_GetItem(self, KIND) ||
        !floats(PyTuple_GetItem(command, 0), UR_JOINTS, into->positions))
        return false;
    PyObject *speeds = PyTuple_GetItem(command, 1);
    into->has_velocities = speeds != NONE;
    return !into->has_velocities || floats(speeds, UR_JOINTS, into->velocities);
}

/* The slip, where it has neither an interruption to count nor a command that rested; `asked` is the
 * command before. */
static bool read_slip(PyObject *self, PyObject *object, PyObject *asked, UrSlip *into)
{
    double rested_s;
    PyObject *interrupted = PyObject_GetAttr(object, PyTuple_GetItem(self, INTERRUPTED));
    if (!interrupted)
        return false;
    Py_DecRef(interrupted);
    return interrupted == &_Py_FalseStruct && is_tuple(asked, 2) &&
           floats(PyTuple_GetItem(asked, 1), UR_JOINTS, into->before) &&
           get_number(self, object, RESTED, &rested_s) && rested_s == 0.0 &&
           get_number(self, object, FASTEST, &into->fastest);
}

/* (command, period_s, beat, asked): the data package. `asked`: the command before, where the slip is to
 * be added; else None. */
static PyObject *answer(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    uint8_t package[UR_COMMAND_SIZE];
    UrReference reference;
    UrSlip slip;
    if (count != 4) {
        PyErr_SetString(PyExc_TypeError, "an answer takes 4 arguments");
        return NULL;
    }
    PyObject *limiter = PyTuple_GetItem(self, LIMITER), *lost = PyTuple_GetItem(self, LOST);
    PyObject *made = NULL, *offsets = NULL, *rates = NULL;
    bool slips = given[3] != NONE;
    double period_s = PyFloat_AsDouble(given[1]);
    int32_t beat = (int32_t)PyLong_AsLongLong(given[2]);
    if (PyErr_Occurred() || !read_command(self, given[0], &reference) ||
        !read_target(self, limiter, &reference) ||
        (slips && !read_slip(self, lost, given[3], &slip)))
        return refused();
    PyObject *references = list_of(self, limiter, REFERENCE, reference.reference);
    PyObject *velocities = references ? list_of(self, limiter, VELOCITY, reference.velocity) : NULL;
    bool good = velocities != NULL;
    if (good && slips) {
        offsets = list_of(self, lost, OFFSET, slip.offset);
        rates = offsets ? list_of(self, lost, RATE, slip.rate) : NULL;
        good = rates && ur_follow(memory(self, MEMORY), &reference, period_s, &slip);
    }
    if (good && ur_answer(memory(self, MEMORY), &reference, period_s, beat, package) &&
        write_list(references, reference.reference) &&
        write_list(velocities, reference.velocity) &&
        set(self, limiter, TARGET,
            slips ? floats_tuple(reference.positions, UR_JOINTS)
                  : held(PyTuple_GetItem(given[0], 0))) &&
        (!slips || (write_list(offsets, slip.offset) && write_list(rates, slip.rate) &&
                    set(self, lost, FASTEST, PyFloat_FromDouble(slip.fastest)))))
        made = PyBytes_FromStringAndSize((const char *)package, sizeof package);
    if (rates)
        Py_DecRef(rates);
    if (offsets)
        Py_DecRef(offsets);
    if (velocities)
        Py_DecRef(velocities);
    if (references)
        Py_DecRef(references);
    return made ? made : refused();
}

#define CALL(name)                                                                                 \
    UR_API PyMethodDef ur_call_##name = {#name, name, METH_FASTCALL, NULL};
CALL(take)
CALL(answer)
