/*
 * `recvfrom` and `sendto` of a UDP socket over IPv4, as Python's own have them, in half the time: an
 * address is not made anew for every datagram of one sender, and none is looked up.
 */
#include <arpa/inet.h>
#include <errno.h>
#include <netinet/in.h>
#include <stdbool.h>
#include <string.h>
#include <sys/socket.h>

#include "message.h"
#include "stable_abi.h"

/* Places in `self`: the socket's `fileno`, a list with the sender that was heard last, the memory of
 * a Heard. */
enum { FILENO, SENDER, HEARD };

/* One more than the longest datagram of EGM. */
#define EGM_RECEIVE_MAX 2049

typedef struct {
    struct sockaddr_in from;
    char data[EGM_RECEIVE_MAX];
} Heard;

EGM_API size_t egm_heard_size(void)
{
    return sizeof(Heard);
}

/* The socket's number as it is now: -1 once it was closed. -2: an exception was raised. */
static int number(PyObject *self)
{
    PyObject *found = PyObject_CallNoArgs(PyTuple_GetItem(self, FILENO));
    if (!found)
        return -2;
    int fd = (int)PyLong_AsLongLong(found);
    Py_DecRef(found);
    return PyErr_Occurred() ? -2 : fd;
}

/* ("192.168.125.1", 6510), the same object as last time where it is the same sender. */
static PyObject *sender(PyObject *self, Heard *heard, const struct sockaddr_in *from)
{
    PyObject *list = PyTuple_GetItem(self, SENDER);
    PyObject *known = PyList_GetItem(list, 0);
    if (!known)
        return NULL;
    if (known == &_Py_NoneStruct || heard->from.sin_port != from->sin_port ||
        heard->from.sin_addr.s_addr != from->sin_addr.s_addr) {
        char host[INET_ADDRSTRLEN] = "";
        inet_ntop(AF_INET, &from->sin_addr, host, sizeof host);
        PyObject *name = PyUnicode_FromString(host);
        PyObject *port = PyLong_FromLongLong(ntohs(from->sin_port));
        known = name && port ? PyTuple_New(2) : NULL;
        if (!known) {
            if (name)
                Py_DecRef(name);
            if (port)
                Py_DecRef(port);
            return NULL;
        }
        PyTuple_SetItem(known, 0, name);
        PyTuple_SetItem(known, 1, port);
        heard->from = *from;
        if (PyList_SetItem(list, 0, known))
            return NULL;
    }
    Py_IncRef(known);
    return known;
}

/* (size): the next datagram, or as much of it, and its sender; waits as long as the socket does. */
static PyObject *recvfrom_ipv4(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    Heard *heard = (Heard *)PyByteArray_AsString(PyTuple_GetItem(self, HEARD));
    struct sockaddr_in from;
    ssize_t size;
    long long largest = count == 1 ? PyLong_AsLongLong(given[0]) : -1;
    if (largest < 0 || largest > EGM_RECEIVE_MAX) {
        if (!PyErr_Occurred())
            PyErr_SetString(PyExc_TypeError, "a datagram has 0 to 2049 bytes here");
        return NULL;
    }
    int fd = number(self), failed;
    do {
        socklen_t length = sizeof from;
        memset(&from, 0, sizeof from);
        if (fd == -2)
            return NULL;
        void *thread = PyEval_SaveThread();
        size = recvfrom(fd, heard->data, (size_t)largest, 0, (struct sockaddr *)&from, &length);
        failed = errno;
        PyEval_RestoreThread(thread);
        if (size < 0 && failed == EINTR && PyErr_CheckSignals())
            return NULL;
        if (size < 0 && failed == EINTR)
            fd = number(self);
    } while (size < 0 && failed == EINTR);
    if (size < 0) {
        errno = failed;
        return PyErr_SetFromErrno(PyExc_OSError);
    }
    PyObject *source = sender(self, heard, &from);
    PyObject *data = source ? PyBytes_FromStringAndSize(heard->data, size) : NULL;
    PyObject *both = data ? PyTuple_New(2) : NULL;
    if (!both) {
        if (source)
            Py_DecRef(source);
        if (data)
            Py_DecRef(data);
        return NULL;
    }
    PyTuple_SetItem(both, 0, data);
    PyTuple_SetItem(both, 1, source);
    return both;
}

/* (data, (host, port)): how much was sent; the host is an address as `recvfrom` gives it. */
static PyObject *sendto_ipv4(PyObject *self, PyObject *const *given, Py_ssize_t count)
{
    struct sockaddr_in to;
    char *data;
    Py_ssize_t size;
    if (count != 2 || PyBytes_AsStringAndSize(given[0], &data, &size)) {
        if (!PyErr_Occurred())
            PyErr_SetString(PyExc_TypeError, "sending takes a message and an address");
        return NULL;
    }
    PyObject *name = PyTuple_GetItem(given[1], 0), *port = PyTuple_GetItem(given[1], 1);
    const char *host = name && port ? PyUnicode_AsUTF8AndSize(name, NULL) : NULL;
    if (!host)
        return NULL;
    memset(&to, 0, sizeof to);
    to.sin_family = AF_INET;
    to.sin_port = htons((uint16_t)PyLong_AsLongLong(port));
    int fd = number(self);
    if (PyErr_Occurred())
        return NULL;
    if (inet_pton(AF_INET, host, &to.sin_addr) != 1) {
        errno = EINVAL;
        return PyErr_SetFromErrno(PyExc_OSError);
    }
    /* Nearly always there is room for it: then no other thread runs before it is out. */
    ssize_t sent = sendto(fd, data, (size_t)size, MSG_DONTWAIT, (struct sockaddr *)&to, sizeof to);
    while (sent < 0 && (errno == EAGAIN || errno == EINTR)) {
        if (errno == EINTR && PyErr_CheckSignals())
            return NULL;
        void *thread = PyEval_SaveThread();
        sent = sendto(fd, data, (size_t)size, 0, (struct sockaddr *)&to, sizeof to);
        int failed = errno;
        PyEval_RestoreThread(thread);
        errno = failed;
        if (sent < 0 && failed == EAGAIN) /* the socket's own time limit */
            break;
    }
    if (sent < 0)
        return PyErr_SetFromErrno(PyExc_OSError);
    return PyLong_FromLongLong(sent);
}

#define CALL(name)                                                                                 \
    EGM_API PyMethodDef egm_call_##name = {#name, name, METH_FASTCALL, NULL};
CALL(recvfrom_ipv4)
CALL(sendto_ipv4)
