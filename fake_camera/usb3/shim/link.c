/* URBs of an open camera, each in one of two queues: pending or done.
 *
 * libusb polls the descriptor for POLLOUT, which usbfs gives when an URB is done, and for POLLERR, which it gives when
 * the device has gone. The write end of a pipe of one page does just that: full while there is nothing to reap,
 * empty when there is, and without a reader when the device has gone.
 */
#define _GNU_SOURCE
#include "pending.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/usbdevice_fs.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { REQUEST_S = 5 }; /* as long as Linux waits for a camera to clear a halt or to choose a setting */

static int fail(int error)
{
    errno = error;
    return -1;
}

static bool is_in(const struct usbdevfs_urb *urb)
{
    if (urb->type == USBDEVFS_URB_TYPE_CONTROL)
        return *(unsigned char *)urb->buffer & IN;
    return urb->endpoint & IN;
}

/* What will be pending; NULL and errno if there is no more memory. */
static struct entry *new_entry(struct usbdevfs_urb *urb)
{
    struct entry *entry = calloc(1, sizeof *entry);
    if (entry && urb) {
        entry->urb = urb;
        entry->endpoint = (unsigned char)((urb->endpoint & 0x0F) | (is_in(urb) ? IN : 0));
        entry->room = (size_t)urb->buffer_length - skipped_bytes(urb);
    }
    return entry;
}

static void forget_unread(struct link *link)
{
    pthread_mutex_lock(&link->lock);
    for (int i = 0; i < ENDPOINTS; i++)
        for (struct entry *entry; (entry = take(&link->unread[i], &link->unread[i].first));)
            free_entry(entry);
    pthread_mutex_unlock(&link->lock);
}

int link_submit(struct link *link, struct usbdevfs_urb *urb)
{
    if (urb->type == USBDEVFS_URB_TYPE_ISO) {
        complain("isochronous transfers are not supported: no USB3 Vision camera uses them");
        return fail(EINVAL);
    }
    if (urb->buffer_length < (int)skipped_bytes(urb))
        return fail(EINVAL);
    struct entry *entry = new_entry(urb);
    if (!entry)
        return -1;
    struct usbip_submit submit = {0};
    pthread_mutex_lock(&link->sending); /* URBs go out in the order of their numbers */
    pthread_mutex_lock(&link->lock);
    bool gone = link->gone, bulk_in = entry->endpoint & IN && entry->endpoint & 0x0F;
    if (gone)
        free_entry(entry);
    else if (bulk_in && holds_back(link, entry->endpoint))
        append(&link->pending, entry);
    else if (!read_unread(link, entry)) {
        submit = numbered(link, entry);
        append(&link->pending, entry);
    }
    pthread_mutex_unlock(&link->lock);
    if (submit.sequence)
        check_sent(link, usbip_send_submit(link->sock, &submit));
    pthread_mutex_unlock(&link->sending);
    return gone ? fail(ENODEV) : 0;
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
    free_entry(entry);
    return 0;
}

/* End a discarded URB; its entry still awaits the camera's answer. If memory is short, it ends with that answer. */
static void end_discarded(struct link *link, struct entry *entry)
{
    struct entry *ended = calloc(1, sizeof *ended);
    unsigned char *data = entry->got ? malloc(entry->room) : NULL; /* the rest of what is just arriving follows */
    if (!ended || (entry->got && !data)) {
        free(ended);
        return;
    }
    if (data)
        memcpy(data, (char *)entry->urb->buffer + skipped_bytes(entry->urb), entry->got);
    ended->urb = entry->urb;
    entry->urb = NULL;
    entry->data = data;
    entry->abandoned = true;
    finish(link, ended, -ENOENT, 0);
}

/* End the discarded URBs of an endpoint, unless another is pending, which would get what the camera is about to send. */
static void end_all_discarded(struct link *link, unsigned char endpoint)
{
    struct entry *entry;
    for (entry = link->pending.first; entry; entry = entry->next)
        if (entry->urb && entry->endpoint == endpoint && entry->sequence && !entry->unlink_sequence)
            return;
    for (entry = link->pending.first; entry; entry = entry->next)
        if (entry->urb && entry->endpoint == endpoint && entry->unlink_sequence)
            end_discarded(link, entry);
}

int link_discard(struct link *link, struct usbdevfs_urb *urb)
{
    uint32_t sequence = 0, unlinked = 0;
    pthread_mutex_lock(&link->sending);
    pthread_mutex_lock(&link->lock);
    struct entry *entry = link->pending.first;
    while (entry && entry->urb != urb)
        entry = entry->next;
    bool found = entry && !entry->unlink_sequence;
    if (found && !entry->sequence) {
        remove_entry(&link->pending, entry);
        finish(link, entry, -ENOENT, 0);
    } else if (found) {
        unlinked = entry->sequence;
        sequence = entry->unlink_sequence = ++link->sequence;
        end_all_discarded(link, entry->endpoint);
    }
    pthread_mutex_unlock(&link->lock);
    if (unlinked)
        check_sent(link, usbip_send_unlink(link->sock, sequence, unlinked));
    pthread_mutex_unlock(&link->sending);
    return found ? 0 : fail(EINVAL);
}

/* Wait for the answer that `entry` expects, or give up. */
static int wait_for(struct link *link, struct entry *entry)
{
    struct timespec until;
    clock_gettime(CLOCK_MONOTONIC, &until);
    until.tv_sec += REQUEST_S;
    pthread_mutex_lock(&link->lock);
    int waited = 0;
    while (!entry->answered && !waited)
        waited = pthread_cond_timedwait(&link->answered, &link->lock, &until);
    bool answered = entry->answered;
    entry->abandoned = !answered; /* the reader frees it */
    int status = !answered ? -ETIMEDOUT : entry->status == -ESHUTDOWN ? -ENODEV : entry->status;
    pthread_mutex_unlock(&link->lock);
    if (answered)
        free_entry(entry);
    return status ? fail(-status) : 0;
}

/* Expect an answer to what the caller sends next, holding `sending`; NULL and errno. */
static struct entry *expect(struct link *link)
{
    struct entry *entry = new_entry(NULL);
    pthread_mutex_lock(&link->lock);
    bool gone = link->gone;
    if (entry && !gone) {
        entry->sequence = ++link->sequence;
        append(&link->pending, entry);
    }
    pthread_mutex_unlock(&link->lock);
    if (entry && gone) {
        free_entry(entry);
        errno = ENODEV;
        return NULL;
    }
    return entry;
}

int link_claim(struct link *link, uint8_t interface, bool claims)
{
    forget_unread(link);
    pthread_mutex_lock(&link->sending);
    struct entry *entry = expect(link);
    if (entry)
        check_sent(link, usbip_send_claim(link->sock, entry->sequence, interface, claims));
    pthread_mutex_unlock(&link->sending);
    return entry ? wait_for(link, entry) : -1;
}

int link_request(struct link *link, uint8_t recipient, uint8_t request, uint16_t value, uint16_t index)
{
    forget_unread(link); /* it clears a halt, or chooses an alternate setting */
    unsigned char setup[SETUP_BYTES] = {recipient, request, value & 0xFF, value >> 8, index & 0xFF, index >> 8, 0, 0};
    pthread_mutex_lock(&link->sending);
    struct entry *entry = expect(link);
    if (entry) {
        struct usbip_submit submit = {.sequence = entry->sequence, .setup = setup};
        check_sent(link, usbip_send_submit(link->sock, &submit));
    }
    pthread_mutex_unlock(&link->sending);
    return entry ? wait_for(link, entry) : -1;
}

/* --- opened and closed --- */

static bool start(struct link *link)
{
    pthread_condattr_t monotonic;
    pthread_condattr_init(&monotonic);
    pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
    pthread_mutex_init(&link->sending, NULL);
    pthread_mutex_init(&link->lock, NULL);
    pthread_cond_init(&link->answered, &monotonic);
    link->pending.end = &link->pending.first;
    link->done.end = &link->done.first;
    for (int i = 0; i < ENDPOINTS; i++)
        link->unread[i].end = &link->unread[i].first;
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
    *link = (struct link){.fd = ends[1], .drain = ends[0], .sock = sock, .owner = getpid()};
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
    if (link->owner != getpid()) { /* forked off: the reader is in the other process, and so is the camera */
        if (!link->gone)
            real_close(link->drain);
        real_close(link->sock);
        real_close(link->fd);
        return;
    }
    shutdown(link->sock, SHUT_RDWR);
    pthread_join(link->reader, NULL); /* now nothing writes into URBs, and our end of the pipe is closed */
    for (struct entry *entry; (entry = take(&link->done, &link->done.first));)
        free_entry(entry);
    forget_unread(link);
    real_close(link->sock);
    real_close(link->fd);
    free(link);
}
