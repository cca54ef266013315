/*
 * Tuples of numbers to and from Python, for the calls of compiled parts. Each call has a
 * tuple as `self`: the memory of its structures and the types and constants of which it makes
 * results.
 */
#ifndef CARDAN_OBJECTS_H
#define CARDAN_OBJECTS_H

#include <stdbool.h>
#include <string.h>

#include "stable_abi.h"

#define NONE (&_Py_NoneStruct)
/* Of one tuple. */
#define FLOATS_MAX 9

static inline PyObject *held(PyObject *object)
{
    Py_IncRef(object);
    return object;
}

/* Types live longer than all that is of them. */
static inline PyObject *type_of(PyObject *object)
{
    PyObject *type = PyObject_Type(object);
    Py_DecRef(type);
    return type;
}

/* The items of a tuple of `count`; false for anything else. */
static inline bool is_tuple(PyObject *object, Py_ssize_t count)
{
    PyObject *type = type_of(object);
    return (type == &PyTuple_Type || PyType_IsSubtype(type, &PyTuple_Type)) &&
           PyTuple_Size(object) == count;
}

/* The numbers of a tuple of `count` floats, which nothing that is only like a float is. */
static inline bool floats(PyObject *object, int count, double *into)
{
    if (!is_tuple(object, count))
        return false;
    for (int i = 0; i < count; i++) {
        PyObject *item = PyTuple_GetItem(object, i);
        if (type_of(item) != &PyFloat_Type)
            return false;
        into[i] = PyFloat_AsDouble(item);
    }
    return true;
}

static inline void *memory(PyObject *self, int place)
{
    return PyByteArray_AsString(PyTuple_GetItem(self, place));
}

/* A tuple of `count` objects, which it takes over; NULL, and none of them is left, where one is. */
static inline PyObject *tuple_of(int count, PyObject *const *items)
{
    PyObject *tuple = PyTuple_New(count);
    bool whole = tuple != NULL;
    for (int i = 0; i < count; i++)
        whole = whole && items[i];
    for (int i = 0; i < count; i++) {
        if (whole)
            PyTuple_SetItem(tuple, i, items[i]);
        else if (items[i])
            Py_DecRef(items[i]);
    }
    if (!whole && tuple) {
        Py_DecRef(tuple);
        tuple = NULL;
    }
    return tuple;
}

static inline PyObject *floats_tuple(const double *values, int count)
{
    PyObject *items[FLOATS_MAX];
    for (int i = 0; i < count; i++)
        items[i] = PyFloat_FromDouble(values[i]);
    return tuple_of(count, items);
}

/* A named tuple of `type` from a tuple, which it takes over. */
static inline PyObject *named(PyObject *type, PyObject *items)
{
    PyObject *(*new)(PyObject *, PyObject *, PyObject *);
    void *slot = PyType_GetSlot(&PyTuple_Type, Py_tp_new);
    memcpy(&new, &slot, sizeof slot);
    PyObject *given = tuple_of(1, &items), *made = NULL;
    if (given) {
        made = new (type, given, NULL);
        Py_DecRef(given);
    }
    return made;
}

/* What a call gives for what it leaves to others. */
static inline PyObject *refused(void)
{
    return PyErr_Occurred() ? NULL : held(NONE);
}

/* Whether `object` is of the very type that is at a place of `self`, with so many fields. */
static inline bool is_kind(PyObject *self, int kind, PyObject *object, Py_ssize_t fields)
{
    return type_of(object) == PyTuple_GetItem(self, kind) && PyTuple_Size(object) == fields;
}

#endif
