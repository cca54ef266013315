/*
 * What cardan/gateway/servo/compiled.py calls in every cycle. Places in `self`: the kernel's address,
 * then the types and the frame of a pose.
 */
#include "kernel.h"
#include "objects.h"

enum { KERNEL, POSE, VECTOR, QUATERNION, BASE };

static Kernel *kernel_of(PyObject *self)
{
    return (Kernel *)(intptr_t)PyLong_AsLongLong(PyTuple_GetItem(self, KERNEL));
}

static PyObject *misused(void)
{
    if (!PyErr_Occurred())
        PyErr_SetString(PyExc_TypeError, "a wrong number of arguments");
    return NULL;
}

/* (): of the robot at pose_joints its TCP, how far the joint that is farthest is away, and which */
static PyObject *measure(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    if (count)
        return misused();
    Kernel *kernel = kernel_of(self);
    KernelState *state = kernel_state(kernel);
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

/* (dt_s, flags): the path speed */
static PyObject *tick(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    double dt_s = count == 2 ? PyFloat_AsDouble(given[0]) : 0.0;
    int32_t flags = count == 2 ? (int32_t)PyLong_AsLongLong(given[1]) : 0;
    if (count != 2 || PyErr_Occurred())
        return misused();
    return PyFloat_FromDouble(kernel_tick(kernel_of(self), dt_s, flags));
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
CALL(note)
