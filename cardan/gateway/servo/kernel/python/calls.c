/*
 * What cardan/gateway/servo/compiled.py calls in every cycle. Places in `self`: the kernel's address,
 * then the types and the frame of a pose, and how many joints there are.
 */
#include <math.h>

#include "kernel.h"
#include "objects.h"

enum { KERNEL, POSE, VECTOR, QUATERNION, BASE, JOINTS };

static Kernel *kernel_of(PyObject *self)
{
    return (Kernel *)(intptr_t)PyLong_AsLongLong(PyTuple_GetItem(self, KERNEL));
}

static int joints_of(PyObject *self)
{
    return (int)PyLong_AsLongLong(PyTuple_GetItem(self, JOINTS));
}

static PyObject *misused(void)
{
    if (!PyErr_Occurred())
        PyErr_SetString(PyExc_TypeError, "a wrong number of arguments, or of numbers in one");
    return NULL;
}

/* The numbers of a sequence of `count`; false, with an error, for anything else. */
static bool read_numbers(PyObject *object, int count, double *into)
{
    if (PySequence_Size(object) != count)
        return false;
    for (int i = 0; i < count; i++) {
        PyObject *item = PySequence_GetItem(object, i);
        if (!item)
            return false;
        into[i] = PyFloat_AsDouble(item);
        Py_DecRef(item);
    }
    return !PyErr_Occurred();
}

/* (joints): of the robot there its TCP, how far the joint that is farthest is away, and which */
static PyObject *measure(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    Kernel *kernel = kernel_of(self);
    KernelState *state = kernel_state(kernel);
    if (count != 1 || !read_numbers(given[0], joints_of(self), state->pose_joints))
        return misused();
    int32_t joint = kernel_measure(kernel);
    PyObject *parts[] = {
        named(PyTuple_GetItem(self, VECTOR), floats_tuple(state->pose_position, 3)),
        named(PyTuple_GetItem(self, QUATERNION), floats_tuple(state->pose_orientation, 4)),
        held(PyTuple_GetItem(self, BASE)),
    };
    PyObject *found[] = {
        named(PyTuple_GetItem(self, POSE), tuple_of(3, parts)),
        PyFloat_FromDouble(state->joint_error),
        PyLong_FromLongLong(joint),
    };
    return tuple_of(3, found);
}

/* (pose, linear, angular, dt_s, flags): the path speed */
static PyObject *tick(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    KernelState *state = kernel_state(kernel_of(self));
    double dt_s = count == 5 ? PyFloat_AsDouble(given[3]) : 0.0;
    int32_t flags = count == 5 ? (int32_t)PyLong_AsLongLong(given[4]) : 0;
    if (count != 5 || PyErr_Occurred() || !is_tuple(given[0], 3) ||
        !read_numbers(PyTuple_GetItem(given[0], 0), 3, state->goal_position) ||
        !read_numbers(PyTuple_GetItem(given[0], 1), 4, state->goal_orientation) ||
        !read_numbers(given[1], 3, state->goal_twist) ||
        !read_numbers(given[2], 3, state->goal_twist + 3))
        return misused();
    return PyFloat_FromDouble(kernel_tick(kernel_of(self), dt_s, flags));
}

/* (pose, dt_s): the pose after that time at the twist of the last tick; cardan.spatial.moved has the
 * same arithmetic */
static PyObject *moved(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    double dt_s = count == 2 ? PyFloat_AsDouble(given[1]) : 0.0, at[3], q[4];
    if (count != 2 || PyErr_Occurred() || !is_tuple(given[0], 3) ||
        !read_numbers(PyTuple_GetItem(given[0], 0), 3, at) ||
        !read_numbers(PyTuple_GetItem(given[0], 1), 4, q))
        return misused();
    const double *linear = kernel_state(kernel_of(self))->twist, *angular = linear + 3;
    for (int i = 0; i < 3; i++)
        at[i] += linear[i] * dt_s;
    PyObject *orientation = PyTuple_GetItem(given[0], 1);
    if (angular[0] != 0.0 || angular[1] != 0.0 || angular[2] != 0.0) {
        double x = angular[0] * dt_s, y = angular[1] * dt_s, z = angular[2] * dt_s;
        double angle = sqrt(x * x + y * y + z * z);
        double factor = angle < 1e-8 ? 0.5 : sin(0.5 * angle) / angle;
        double a = cos(0.5 * angle), b = x * factor, c = y * factor, d = z * factor;
        double turned[] = {
            a * q[0] - b * q[1] - c * q[2] - d * q[3],
            a * q[1] + b * q[0] + c * q[3] - d * q[2],
            a * q[2] - b * q[3] + c * q[0] + d * q[1],
            a * q[3] + b * q[2] - c * q[1] + d * q[0],
        };
        double length = sqrt(turned[0] * turned[0] + turned[1] * turned[1] +
                             turned[2] * turned[2] + turned[3] * turned[3]);
        if (!(1e-12 < length && length < INFINITY)) {
            PyErr_SetString(PyExc_ValueError, "a quaternion that has no direction");
            return NULL;
        }
        for (int i = 0; i < 4; i++)
            turned[i] /= length;
        orientation = named(PyTuple_GetItem(self, QUATERNION), floats_tuple(turned, 4));
    } else {
        held(orientation);
    }
    PyObject *parts[] = {
        named(PyTuple_GetItem(self, VECTOR), floats_tuple(at, 3)),
        orientation,
        held(PyTuple_GetItem(self, BASE)),
    };
    return named(PyTuple_GetItem(self, POSE), tuple_of(3, parts));
}

/* (): the commanded joints and their velocities */
static PyObject *targets(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    if (count)
        return misused();
    const KernelState *state = kernel_state(kernel_of(self));
    int joints = joints_of(self);
    PyObject *found[] = {floats_tuple(state->q, joints), floats_tuple(state->v, joints)};
    return tuple_of(2, found);
}

/* (stamp_s) */
static PyObject *note(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    double stamp_s = count == 1 ? PyFloat_AsDouble(given[0]) : 0.0;
    if (count != 1 || PyErr_Occurred())
        return misused();
    kernel_note(kernel_of(self), stamp_s);
    return held(NONE);
}

#define CALL(name)                                                                                 \
    KERNEL_API PyMethodDef kernel_call_##name = {#name, name, METH_FASTCALL, 0};
CALL(measure)
CALL(tick)
CALL(moved)
CALL(targets)
CALL(note)
