/* An open camera, as of /dev/bus/usb/BUS/DEVICE: its URBs, each with a place in one of two queues, on their way or done.
 *
 * libusb polls the descriptor for POLLOUT, which usbfs gives when an URB is done, and for POLLERR, which it gives when
 * the device has gone. The write end of a pipe with room for one piece does just that: full, there is nothing to reap;
 * emptied, there is; and without a reader, the device has gone.
 */
#define _GNU_SOURCE
#include "shim.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/usbdevice_fs.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

enum { MAX_DESCRIPTORS = 4096, SETUP_BYTES = 8 };
enum { CLEAR_FEATURE = 1, SET_CONFIGURATION = 9, SET_INTERFACE = 11, TO_DEVICE = 0, TO_INTERFACE = 1, TO_ENDPOINT = 2 };

/* What waits for an answer: an URB of libusb's, or a call that this library makes for an ioctl and that waits. */
struct entry {
    struct entry *next;
    uint32_t sequence, unlink_sequence;
    struct usbdevfs_urb *urb;
    bool answered;
    int status;
};

struct queue {
    struct entry *first, **end;
};

struct handle {
    int fd, drain, sock; /* libusb's end of the pipe, ours, and the connection */
    pthread_t reader;
    pthread_mutex_t sending;
    pthread_mutex_t lock; /* guards all below */
    pthread_cond_t answered;
    struct queue pending, done;
    uint32_t sequence;
    bool gone;
};

static _Atomic(struct handle *) handles[MAX_DESCRIPTORS];

static void append(struct queue *queue, struct entry *entry)
{
    entry->next = NULL;
    *queue->end = entry;
    queue->end = &entry->next;
}

static struct entry *take(struct queue *queue, struct entry **at)
{
    struct entry *entry = *at;
    if (entry && !(*at = entry->next))
        queue->end = at;
    return entry;
}

/* --- what the camera answers; the lock is held --- */

static void finish(struct handle *handle, struct entry *entry, int status, uint32_t actual_length)
{
    if (!entry->urb) {
        entry->answered = true;
        entry->status = status;
        pthread_cond_broadcast(&handle->answered);
        return;
    }
    char byte;
    if (!handle->done.first && !handle->gone && read(handle->drain, &byte, 1) < 0)
        complain("the pipe to libusb cannot be read: %s", strerror(errno));
    entry->urb->status = status;
    entry->urb->actual_length = (int)actual_length;
    append(&handle->done, entry);
}

static struct entry *take_pending(struct handle *handle, const struct usbip_return *answer)
{
    for (struct entry **at = &handle->pending.first; *at; at = &(*at)->next)
        if ((answer->answer == USBIP_UNLINKED ? (*at)->unlink_sequence : (*at)->sequence) == answer->sequence)
            return take(&handle->pending, at);
    return NULL;
}

static bool is_in(const struct usbdevfs_urb *urb)
{
    if (urb->type == USBDEVFS_URB_TYPE_CONTROL)
        return *(unsigned char *)urb->buffer & 0x80;
    return urb->endpoint & 0x80;
}

/* Data go straight into the URB's buffer, which stays valid until libusb has reaped it or closed the descriptor. */
static bool receive_data(struct handle *handle, struct entry *entry, uint32_t bytes)
{
    struct usbdevfs_urb *urb = entry->urb;
    if (!urb || !is_in(urb) || bytes == 0)
        return true;
    size_t skip = urb->type == USBDEVFS_URB_TYPE_CONTROL ? SETUP_BYTES : 0;
    return bytes + skip <= (size_t)urb->buffer_length && usbip_receive(handle->sock, (char *)urb->buffer + skip, bytes);
}

static bool receive_answer(struct handle *handle)
{
    struct usbip_return answer;
    if (!usbip_receive_return(handle->sock, &answer))
        return false;
    bool taken_back = answer.answer == USBIP_UNLINKED && answer.status != 0;
    if (answer.answer == USBIP_UNLINKED && !taken_back)
        return true; /* too late: it has been answered */
    pthread_mutex_lock(&handle->lock);
    struct entry *entry = take_pending(handle, &answer);
    pthread_mutex_unlock(&handle->lock);
    if (!entry)
        return false;
    bool complete = taken_back || receive_data(handle, entry, answer.actual_length);
    pthread_mutex_lock(&handle->lock);
    finish(handle, entry, taken_back ? -ENOENT : complete ? answer.status : -ESHUTDOWN, answer.actual_length);
    pthread_mutex_unlock(&handle->lock);
    return complete;
}

static void *read_answers(void *argument)
{
    struct handle *handle = argument;
    while (receive_answer(handle))
        continue;
    pthread_mutex_lock(&handle->lock);
    for (struct entry *entry; (entry = take(&handle->pending, &handle->pending.first));)
        finish(handle, entry, -ESHUTDOWN, 0);
    handle->gone = true;
    real_close(handle->drain);
    pthread_mutex_unlock(&handle->lock);
    return NULL;
}

/* --- what libusb asks --- */

static int fail(int error)
{
    errno = error;
    return -1;
}

/* Note that an answer will come; without the lock, as sending may take time. */
static struct entry *expect(struct handle *handle, struct usbdevfs_urb *urb)
{
    struct entry *entry = calloc(1, sizeof *entry);
    if (!entry)
        return NULL;
    entry->urb = urb;
    pthread_mutex_lock(&handle->lock);
    bool gone = handle->gone;
    if (!gone) {
        entry->sequence = ++handle->sequence;
        append(&handle->pending, entry);
    }
    pthread_mutex_unlock(&handle->lock);
    if (gone) {
        free(entry);
        errno = ENODEV;
        return NULL;
    }
    return entry;
}

static int submit_urb(struct handle *handle, struct usbdevfs_urb *urb)
{
    if (urb->type == USBDEVFS_URB_TYPE_ISO) {
        complain("isochronous transfers are not supported: no USB3 Vision camera has any");
        return fail(EINVAL);
    }
    bool control = urb->type == USBDEVFS_URB_TYPE_CONTROL;
    size_t skip = control ? SETUP_BYTES : 0;
    if ((size_t)urb->buffer_length < skip)
        return fail(EINVAL);
    struct usbip_submit submit = {
        .endpoint = (urb->endpoint & 0x0F) | (is_in(urb) ? 0x80 : 0),
        .length = (uint32_t)(urb->buffer_length - (int)skip),
        .setup = control ? urb->buffer : NULL,
        .data = (char *)urb->buffer + skip,
    };
    pthread_mutex_lock(&handle->sending); /* URBs go out in the order of their numbers */
    struct entry *entry = expect(handle, urb);
    if (entry) {
        submit.sequence = entry->sequence;
        usbip_send_submit(handle->sock, &submit); /* when it fails the reader ends, too, and with it all URBs */
    }
    pthread_mutex_unlock(&handle->sending);
    return entry ? 0 : -1;
}

static int reap_urb(struct handle *handle, struct usbdevfs_urb **urb)
{
    pthread_mutex_lock(&handle->lock);
    struct entry *entry = take(&handle->done, &handle->done.first);
    if (entry && !handle->done.first && !handle->gone && write(handle->fd, "", 1) < 0)
        complain("the pipe of libusb cannot be filled: %s", strerror(errno));
    bool gone = handle->gone;
    pthread_mutex_unlock(&handle->lock);
    if (!entry)
        return fail(gone ? ENODEV : EAGAIN);
    *urb = entry->urb;
    free(entry);
    return 0;
}

static int discard_urb(struct handle *handle, struct usbdevfs_urb *urb)
{
    pthread_mutex_lock(&handle->sending);
    pthread_mutex_lock(&handle->lock);
    struct entry *entry = handle->pending.first;
    while (entry && entry->urb != urb)
        entry = entry->next;
    uint32_t sequence = 0, unlinked = 0;
    if (entry) {
        unlinked = entry->sequence;
        sequence = entry->unlink_sequence = ++handle->sequence;
    }
    pthread_mutex_unlock(&handle->lock);
    if (unlinked)
        usbip_send_unlink(handle->sock, sequence, unlinked);
    pthread_mutex_unlock(&handle->sending);
    return unlinked ? 0 : fail(EINVAL);
}

/* Ask the camera something and wait for the answer: a claim when `setup` is NULL, else a request without data. */
static int ask(struct handle *handle, const unsigned char *setup, uint8_t interface, bool claims)
{
    pthread_mutex_lock(&handle->sending);
    struct entry *entry = expect(handle, NULL);
    if (entry && setup) {
        struct usbip_submit submit = {.sequence = entry->sequence, .setup = setup};
        usbip_send_submit(handle->sock, &submit);
    } else if (entry)
        usbip_send_claim(handle->sock, entry->sequence, interface, claims);
    pthread_mutex_unlock(&handle->sending);
    if (!entry)
        return -1;
    pthread_mutex_lock(&handle->lock);
    while (!entry->answered)
        pthread_cond_wait(&handle->answered, &handle->lock);
    pthread_mutex_unlock(&handle->lock);
    int status = entry->status == -ESHUTDOWN ? -ENODEV : entry->status;
    free(entry);
    return status ? fail(-status) : 0;
}

static int request(struct handle *handle, unsigned char recipient, unsigned char what, unsigned value, unsigned index)
{
    unsigned char setup[SETUP_BYTES] = {recipient, what, value & 0xFF, value >> 8, index & 0xFF, index >> 8, 0, 0};
    return ask(handle, setup, 0, false);
}

static int control(struct handle *handle, unsigned long what, void *argument)
{
    switch (what) {
    case USBDEVFS_SUBMITURB:
        return submit_urb(handle, argument);
    case USBDEVFS_REAPURBNDELAY:
        return reap_urb(handle, argument);
    case USBDEVFS_DISCARDURB:
        return discard_urb(handle, argument);
    case USBDEVFS_GET_CAPABILITIES: /* scatter-gather: each transfer is one URB */
        *(uint32_t *)argument = USBDEVFS_CAP_BULK_SCATTER_GATHER | USBDEVFS_CAP_REAP_AFTER_DISCONNECT;
        return 0;
    case USBDEVFS_CLAIMINTERFACE:
        return ask(handle, NULL, *(unsigned *)argument & 0xFF, true);
    case USBDEVFS_RELEASEINTERFACE:
        return ask(handle, NULL, *(unsigned *)argument & 0xFF, false);
    case USBDEVFS_DISCONNECT_CLAIM:
        return ask(handle, NULL, ((struct usbdevfs_disconnect_claim *)argument)->interface & 0xFF, true);
    case USBDEVFS_CLEAR_HALT:
        return request(handle, TO_ENDPOINT, CLEAR_FEATURE, 0, *(unsigned *)argument);
    case USBDEVFS_SETCONFIGURATION:
        return request(handle, TO_DEVICE, SET_CONFIGURATION, *(unsigned *)argument, 0);
    case USBDEVFS_SETINTERFACE: {
        struct usbdevfs_setinterface *set = argument;
        return request(handle, TO_INTERFACE, SET_INTERFACE, set->altsetting, set->interface);
    }
    case USBDEVFS_GETDRIVER: /* no kernel driver has or wants the camera */
    case USBDEVFS_IOCTL:
        return fail(ENODATA);
    default:
        complain("libusb needs the usbfs call %#lx, which is missing: add it to handle.c", what);
        return fail(ENOTTY);
    }
}

/* --- open, ioctl, close --- */

static struct handle *handle_of(int fd)
{
    return fd >= 0 && fd < MAX_DESCRIPTORS ? atomic_load(&handles[fd]) : NULL;
}

bool handle_ioctl(int fd, unsigned long what, void *argument, int *result)
{
    struct handle *handle = handle_of(fd);
    if (handle)
        *result = control(handle, what, argument);
    return handle != NULL;
}

int handle_open(int device)
{
    int ends[2], sock = bus_connect(device);
    if (sock < 0)
        return -1;
    struct handle *handle = calloc(1, sizeof *handle);
    if (!handle || pipe2(ends, O_CLOEXEC | O_NONBLOCK) < 0) {
        free(handle);
        real_close(sock);
        return fail(ENOMEM);
    }
    *handle = (struct handle){.fd = ends[1], .drain = ends[0], .sock = sock};
    pthread_mutex_init(&handle->sending, NULL);
    pthread_mutex_init(&handle->lock, NULL);
    pthread_cond_init(&handle->answered, NULL);
    handle->pending.end = &handle->pending.first;
    handle->done.end = &handle->done.first;
    if (handle->fd < MAX_DESCRIPTORS && fcntl(handle->fd, F_SETPIPE_SZ, 1) > 0 && write(handle->fd, "", 1) == 1
        && pthread_create(&handle->reader, NULL, read_answers, handle) == 0) {
        atomic_store(&handles[handle->fd], handle);
        return handle->fd;
    }
    real_close(ends[0]);
    real_close(ends[1]);
    real_close(sock);
    free(handle);
    return fail(EMFILE);
}

bool handle_close(int fd)
{
    struct handle *handle = handle_of(fd);
    if (!handle)
        return false;
    atomic_store(&handles[fd], NULL);
    shutdown(handle->sock, SHUT_RDWR);
    pthread_join(handle->reader, NULL); /* from here on nothing writes into URBs; it has closed its end of the pipe */
    for (struct entry *entry; (entry = take(&handle->done, &handle->done.first));)
        free(entry);
    real_close(handle->sock);
    real_close(handle->fd);
    free(handle);
    return true;
}
