/* URBs of an open camera, each in one of two queues: pending or done.
 *
 * libusb polls the descriptor for POLLOUT, which usbfs gives when an URB is done, and for POLLERR, which it gives when
 * the device has gone. The write end of a pipe of one page does just that: full while there is nothing to reap,
 * empty when there is, and without a reader when the device has gone.
 */
#define _GNU_SOURCE
#include "shim.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/usbdevice_fs.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum { SETUP_BYTES = 8, ENDPOINTS = 16 };

/* What waits for an answer: an URB of libusb, or (`urb` is NULL) an ioctl that blocks until then, or what was an URB
 * until it was discarded (`discarded`). */
struct entry {
    struct entry *next;
    uint32_t sequence, unlink_sequence;
    struct usbdevfs_urb *urb;
    bool answered, discarded;
    int status, endpoint;
};

/* What a camera sent for an URB that had just been discarded. With a host controller it would still be in the camera:
 * the next URB gets it. */
struct unread {
    int unanswered; /* discarded URBs that the camera may still answer */
    unsigned char *data;
    size_t bytes;
};

struct queue {
    struct entry *first, **end;
};

struct link {
    int fd, drain, sock; /* libusb's end of the pipe, ours, and the connection */
    pthread_t reader;
    pthread_mutex_t sending;
    pthread_mutex_t lock; /* guards all below */
    pthread_cond_t answered;
    struct queue pending, done;
    struct unread unread[ENDPOINTS]; /* of bulk IN endpoints, by their number */
    uint32_t sequence;
    bool gone;
};

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

static void finish(struct link *link, struct entry *entry, int status, uint32_t actual_length)
{
    if (!entry->urb) {
        entry->answered = true;
        entry->status = status;
        pthread_cond_broadcast(&link->answered);
        return;
    }
    char byte;
    if (!link->done.first && !link->gone && read(link->drain, &byte, 1) < 0)
        complain("cannot read the pipe to libusb: %s", strerror(errno));
    entry->urb->status = status;
    entry->urb->actual_length = (int)actual_length;
    append(&link->done, entry);
}

static struct entry *take_pending(struct link *link, const struct usbip_return *answer)
{
    for (struct entry **at = &link->pending.first; *at; at = &(*at)->next)
        if ((answer->kind == USBIP_UNLINKED ? (*at)->unlink_sequence : (*at)->sequence) == answer->sequence)
            return take(&link->pending, at);
    return NULL;
}

static bool is_in(const struct usbdevfs_urb *urb)
{
    if (urb->type == USBDEVFS_URB_TYPE_CONTROL)
        return *(unsigned char *)urb->buffer & 0x80;
    return urb->endpoint & 0x80;
}

/* Data go straight into the URB's buffer, which stays valid until libusb has reaped it or closed the descriptor. */
static bool receive_data(struct link *link, struct entry *entry, uint32_t bytes)
{
    struct usbdevfs_urb *urb = entry->urb;
    if (!urb || !is_in(urb) || bytes == 0)
        return true;
    size_t skip = urb->type == USBDEVFS_URB_TYPE_CONTROL ? SETUP_BYTES : 0;
    return bytes + skip <= (size_t)urb->buffer_length && usbip_receive(link->sock, (char *)urb->buffer + skip, bytes);
}

/* The answer to a discarded URB: it was cancelled in time, or what was sent for it is kept. */
static bool receive_unread(struct link *link, struct entry *entry, uint32_t bytes)
{
    struct unread *unread = &link->unread[entry->endpoint];
    unsigned char *data = bytes ? malloc(bytes) : NULL;
    bool complete = !bytes || (data && usbip_receive(link->sock, data, bytes));
    pthread_mutex_lock(&link->lock);
    if (complete && bytes) {
        free(unread->data);
        *unread = (struct unread){.unanswered = unread->unanswered, .data = data, .bytes = bytes};
    } else
        free(data);
    unread->unanswered--;
    pthread_cond_broadcast(&link->answered);
    pthread_mutex_unlock(&link->lock);
    free(entry);
    return complete;
}

static bool receive_answer(struct link *link)
{
    struct usbip_return answer;
    if (!usbip_receive_return(link->sock, &answer))
        return false;
    bool cancelled = answer.kind == USBIP_UNLINKED && answer.status != 0;
    if (answer.kind == USBIP_UNLINKED && !cancelled)
        return true; /* too late to cancel: it has been answered */
    pthread_mutex_lock(&link->lock);
    struct entry *entry = take_pending(link, &answer);
    pthread_mutex_unlock(&link->lock);
    if (!entry)
        return false;
    if (entry->discarded)
        return receive_unread(link, entry, cancelled ? 0 : answer.actual_length);
    bool complete = cancelled || receive_data(link, entry, answer.actual_length);
    pthread_mutex_lock(&link->lock);
    int status = cancelled ? -ENOENT : complete ? answer.status : -ESHUTDOWN;
    finish(link, entry, status, complete ? answer.actual_length : 0);
    pthread_mutex_unlock(&link->lock);
    return complete;
}

static void *read_answers(void *argument)
{
    struct link *link = argument;
    while (receive_answer(link))
        continue;
    pthread_mutex_lock(&link->lock);
    for (struct entry *entry; (entry = take(&link->pending, &link->pending.first));)
        if (entry->discarded)
            free(entry);
        else
            finish(link, entry, -ESHUTDOWN, 0);
    link->gone = true;
    pthread_cond_broadcast(&link->answered);
    real_close(link->drain);
    pthread_mutex_unlock(&link->lock);
    return NULL;
}

/* --- what libusb asks --- */

static int fail(int error)
{
    errno = error;
    return -1;
}

/* Expect an answer. The caller sends the request afterwards, without the lock, as sending may take time. */
static struct entry *expect(struct link *link, struct usbdevfs_urb *urb)
{
    struct entry *entry = calloc(1, sizeof *entry);
    if (!entry)
        return NULL;
    entry->urb = urb;
    pthread_mutex_lock(&link->lock);
    bool gone = link->gone;
    if (!gone) {
        entry->sequence = ++link->sequence;
        append(&link->pending, entry);
    }
    pthread_mutex_unlock(&link->lock);
    if (gone) {
        free(entry);
        errno = ENODEV;
        return NULL;
    }
    return entry;
}

static bool is_bulk_in(const struct usbdevfs_urb *urb)
{
    return urb->type == USBDEVFS_URB_TYPE_BULK && urb->endpoint & 0x80;
}

/* Complete an URB with what was sent for a discarded one; false: there is nothing. */
static bool read_unread(struct link *link, struct usbdevfs_urb *urb)
{
    struct unread *unread = &link->unread[urb->endpoint & 0x0F];
    struct entry *entry = NULL;
    pthread_mutex_lock(&link->lock);
    while (unread->unanswered && !link->gone)
        pthread_cond_wait(&link->answered, &link->lock);
    if (unread->bytes && !link->gone && (entry = calloc(1, sizeof *entry))) {
        size_t bytes = (size_t)urb->buffer_length < unread->bytes ? (size_t)urb->buffer_length : unread->bytes;
        memcpy(urb->buffer, unread->data, bytes);
        memmove(unread->data, unread->data + bytes, unread->bytes -= bytes);
        entry->urb = urb;
        finish(link, entry, 0, (uint32_t)bytes);
    }
    pthread_mutex_unlock(&link->lock);
    return entry;
}

static void forget_unread(struct link *link)
{
    pthread_mutex_lock(&link->lock);
    for (int i = 0; i < ENDPOINTS; i++)
        link->unread[i].bytes = 0;
    pthread_mutex_unlock(&link->lock);
}

int link_submit(struct link *link, struct usbdevfs_urb *urb)
{
    if (urb->type == USBDEVFS_URB_TYPE_ISO) {
        complain("isochronous transfers are not supported: no USB3 Vision camera uses them");
        return fail(EINVAL);
    }
    bool control = urb->type == USBDEVFS_URB_TYPE_CONTROL;
    size_t skip = control ? SETUP_BYTES : 0;
    if ((size_t)urb->buffer_length < skip)
        return fail(EINVAL);
    if (is_bulk_in(urb) && read_unread(link, urb))
        return 0;
    struct usbip_submit submit = {
        .endpoint = (urb->endpoint & 0x0F) | (is_in(urb) ? 0x80 : 0),
        .length = (uint32_t)(urb->buffer_length - (int)skip),
        .setup = control ? urb->buffer : NULL,
        .data = (char *)urb->buffer + skip,
    };
    pthread_mutex_lock(&link->sending); /* URBs go out in the order of their numbers */
    struct entry *entry = expect(link, urb);
    if (entry) {
        submit.sequence = entry->sequence;
        usbip_send_submit(link->sock, &submit); /* if it fails, the reader ends as well and finishes all URBs */
    }
    pthread_mutex_unlock(&link->sending);
    return entry ? 0 : -1;
}

int link_reap(struct link *link, struct usbdevfs_urb **urb)
{
    pthread_mutex_lock(&link->lock);
    struct entry *entry = take(&link->done, &link->done.first);
    if (entry && !link->done.first && !link->gone && write(link->fd, "", 1) < 0)
        complain("cannot fill the pipe to libusb: %s", strerror(errno));
    bool gone = link->gone;
    pthread_mutex_unlock(&link->lock);
    if (!entry)
        return fail(gone ? ENODEV : EAGAIN);
    *urb = entry->urb;
    free(entry);
    return 0;
}

/* As with a host controller, an URB ends when it is discarded, whatever the camera is about to send for it; but only
 * if no other is pending on its endpoint, which would get that. The lock is held. */
static void end_at_once(struct link *link, struct entry **at)
{
    struct entry *entry = *at, *rest;
    if (!is_bulk_in(entry->urb))
        return;
    for (struct entry *other = link->pending.first; other; other = other->next)
        if (other != entry && other->urb && other->urb->endpoint == entry->urb->endpoint)
            return;
    if (!(rest = calloc(1, sizeof *rest)))
        return;
    rest->sequence = entry->sequence;
    rest->unlink_sequence = entry->unlink_sequence;
    rest->endpoint = entry->urb->endpoint & 0x0F;
    rest->discarded = true;
    finish(link, take(&link->pending, at), -ENOENT, 0);
    append(&link->pending, rest);
    link->unread[rest->endpoint].unanswered++;
}

int link_discard(struct link *link, struct usbdevfs_urb *urb)
{
    pthread_mutex_lock(&link->sending);
    pthread_mutex_lock(&link->lock);
    struct entry **at = &link->pending.first;
    while (*at && (*at)->urb != urb)
        at = &(*at)->next;
    uint32_t sequence = 0, unlinked = 0;
    if (*at) {
        unlinked = (*at)->sequence;
        sequence = (*at)->unlink_sequence = ++link->sequence;
        end_at_once(link, at);
    }
    pthread_mutex_unlock(&link->lock);
    if (unlinked)
        usbip_send_unlink(link->sock, sequence, unlinked);
    pthread_mutex_unlock(&link->sending);
    return unlinked ? 0 : fail(EINVAL);
}

/* Wait for the answer that `entry` expects. */
static int wait_for(struct link *link, struct entry *entry)
{
    if (!entry)
        return -1;
    pthread_mutex_lock(&link->lock);
    while (!entry->answered)
        pthread_cond_wait(&link->answered, &link->lock);
    pthread_mutex_unlock(&link->lock);
    int status = entry->status == -ESHUTDOWN ? -ENODEV : entry->status;
    free(entry);
    return status ? fail(-status) : 0;
}

int link_claim(struct link *link, uint8_t interface, bool claims)
{
    forget_unread(link);
    pthread_mutex_lock(&link->sending);
    struct entry *entry = expect(link, NULL);
    if (entry)
        usbip_send_claim(link->sock, entry->sequence, interface, claims);
    pthread_mutex_unlock(&link->sending);
    return wait_for(link, entry);
}

int link_request(struct link *link, uint8_t recipient, uint8_t request, uint16_t value, uint16_t index)
{
    forget_unread(link); /* it clears a halt, or chooses an alternate setting */
    unsigned char setup[SETUP_BYTES] = {recipient, request, value & 0xFF, value >> 8, index & 0xFF, index >> 8, 0, 0};
    pthread_mutex_lock(&link->sending);
    struct entry *entry = expect(link, NULL);
    if (entry)
        usbip_send_submit(link->sock, &(struct usbip_submit){.sequence = entry->sequence, .setup = setup});
    pthread_mutex_unlock(&link->sending);
    return wait_for(link, entry);
}

/* --- opened and closed --- */

static bool start(struct link *link)
{
    pthread_mutex_init(&link->sending, NULL);
    pthread_mutex_init(&link->lock, NULL);
    pthread_cond_init(&link->answered, NULL);
    link->pending.end = &link->pending.first;
    link->done.end = &link->done.first;
    return fcntl(link->fd, F_SETPIPE_SZ, 1) > 0 && write(link->fd, "", 1) == 1
        && pthread_create(&link->reader, NULL, read_answers, link) == 0;
}

struct link *link_open(int sock, int *fd)
{
    int ends[2];
    struct link *link = calloc(1, sizeof *link);
    if (!link || pipe2(ends, O_CLOEXEC | O_NONBLOCK) < 0) {
        free(link);
        return NULL;
    }
    *link = (struct link){.fd = ends[1], .drain = ends[0], .sock = sock};
    *fd = link->fd;
    if (start(link))
        return link;
    real_close(ends[0]);
    real_close(ends[1]);
    free(link);
    return NULL;
}

void link_close(struct link *link)
{
    shutdown(link->sock, SHUT_RDWR);
    pthread_join(link->reader, NULL); /* now nothing writes into URBs, and our end of the pipe is closed */
    for (struct entry *entry; (entry = take(&link->done, &link->done.first));)
        free(entry);
    for (int i = 0; i < ENDPOINTS; i++)
        free(link->unread[i].data);
    real_close(link->sock);
    real_close(link->fd);
    free(link);
}
