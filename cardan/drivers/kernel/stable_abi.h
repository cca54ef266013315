/*
 * The functions of Python that the compiled parts call. All are of its stable ABI, which no version from
 * 3.10 on changes (docs.python.org, C API Stability): declared here, so that one library, compiled
 * without any Python, serves all of them. No object is looked into but by these functions.
 */
#ifndef CARDAN_STABLE_ABI_H
#define CARDAN_STABLE_ABI_H

#include <stdint.h>

typedef struct _object PyObject;
typedef intptr_t Py_ssize_t;

typedef struct {
    const char *name;
    PyObject *(*function)(PyObject *self, PyObject *const *given, Py_ssize_t count);
    int flags;
    const char *doc;
} PyMethodDef;

#define METH_FASTCALL 0x0080
#define Py_tp_new 65

extern PyObject PyFloat_Type, PyTuple_Type, PyBytes_Type;
extern PyObject _Py_NoneStruct, _Py_TrueStruct, _Py_FalseStruct;
extern PyObject *PyExc_TypeError, *PyExc_ValueError, *PyExc_OSError;

extern void Py_IncRef(PyObject *);
extern void Py_DecRef(PyObject *);
extern PyObject *PyErr_Occurred(void);
extern void PyErr_Clear(void);
extern void PyErr_SetString(PyObject *, const char *);
extern PyObject *PyErr_SetFromErrno(PyObject *);
extern int PyErr_CheckSignals(void);
extern void *PyEval_SaveThread(void);
extern void PyEval_RestoreThread(void *);
extern PyObject *PyObject_CallNoArgs(PyObject *);
extern PyObject *PyObject_GetAttr(PyObject *, PyObject *);
extern int PyObject_SetAttr(PyObject *, PyObject *, PyObject *);
extern PyObject *PyObject_Type(PyObject *);
extern int PyType_IsSubtype(PyObject *, PyObject *);
extern void *PyType_GetSlot(PyObject *, int);
extern PyObject *PyFloat_FromDouble(double);
extern double PyFloat_AsDouble(PyObject *);
extern PyObject *PyLong_FromLongLong(long long);
extern long long PyLong_AsLongLong(PyObject *);
extern char *PyByteArray_AsString(PyObject *);
extern PyObject *PyBytes_FromStringAndSize(const char *, Py_ssize_t);
extern int PyBytes_AsStringAndSize(PyObject *, char **, Py_ssize_t *);
extern PyObject *PyUnicode_FromString(const char *);
extern const char *PyUnicode_AsUTF8AndSize(PyObject *, Py_ssize_t *);
extern PyObject *PyList_GetItem(PyObject *, Py_ssize_t); /* borrowed */
extern int PyList_SetItem(PyObject *, Py_ssize_t, PyObject *); /* takes the reference over */
extern Py_ssize_t PySequence_Size(PyObject *);
extern PyObject *PySequence_GetItem(PyObject *, Py_ssize_t);
extern PyObject *PyTuple_New(Py_ssize_t);
extern Py_ssize_t PyTuple_Size(PyObject *);
extern PyObject *PyTuple_GetItem(PyObject *, Py_ssize_t); /* borrowed */
extern int PyTuple_SetItem(PyObject *, Py_ssize_t, PyObject *); /* takes the reference over */

#endif
