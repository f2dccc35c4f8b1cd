/* What a camera answers, on a thread of each open camera. */
#define _GNU_SOURCE
#include "pending.h"

#include <errno.h>
#include <linux/usbdevice_fs.h>
#include <stdlib.h>
#include <sys/socket.h>

/* A message that was not sent as a whole ends the connection: the reader then finishes all URBs. */
void check_sent(struct link *link, bool sent)
{
    if (!sent)
        shutdown(link->sock, SHUT_RDWR);
}

static struct entry *find_pending(const struct link *link, const struct usbip_return *answer)
{
    struct entry *entry = link->pending.first;
    while (entry && (answer->kind == USBIP_UNLINKED ? entry->unlink_sequence : entry->sequence) != answer->sequence)
        entry = entry->next;
    return entry;
}

/* Data go straight into the URB's buffer, which stays valid until it is discarded, or libusb closes the descriptor. */
static bool receive_piece(struct link *link, struct entry *entry, size_t bytes)
{
    size_t got = 0;
    pthread_mutex_lock(&link->lock);
    bool there = entry->urb || entry->data || (entry->data = malloc(bytes));
    if (there) {
        char *start = entry->urb ? (char *)entry->urb->buffer + skipped_bytes(entry->urb) : (char *)entry->data;
        there = usbip_receive_some(link->sock, start + entry->got, bytes - entry->got, &got);
    }
    entry->got += got;
    pthread_mutex_unlock(&link->lock);
    return there;
}

static bool receive_data(struct link *link, struct entry *entry, size_t bytes)
{
    while (entry->got < bytes)
        if (!usbip_wait(link->sock) || !receive_piece(link, entry, bytes))
            return false;
    return true;
}

/* The next URB that need not be held back any longer and must be sent; the lock is held. */
static struct entry *next_held(struct link *link, unsigned char endpoint)
{
    for (struct entry **at = &link->pending.first; *at;) {
        struct entry *entry = *at;
        if (entry->endpoint == endpoint && entry->abandoned)
            return NULL;
        if (entry->endpoint == endpoint && !entry->sequence) {
            if (!link->unread[endpoint & 0x0F].first)
                return entry;
            take(&link->pending, at);
            read_unread(link, entry);
        } else
            at = &entry->next;
    }
    return NULL;
}

static void send_held(struct link *link, unsigned char endpoint)
{
    pthread_mutex_lock(&link->sending);
    for (;;) {
        pthread_mutex_lock(&link->lock);
        struct entry *entry = next_held(link, endpoint);
        struct usbip_submit submit = entry ? numbered(link, entry) : (struct usbip_submit){0};
        pthread_mutex_unlock(&link->lock);
        if (!entry)
            break;
        check_sent(link, usbip_send_submit(link->sock, &submit));
    }
    pthread_mutex_unlock(&link->sending);
}

static void conclude(struct link *link, struct entry *entry, int status, size_t actual_length)
{
    pthread_mutex_lock(&link->lock);
    remove_entry(&link->pending, entry);
    unsigned char endpoint = entry->endpoint, number = endpoint & 0x0F;
    bool abandoned = entry->abandoned;
    if (!abandoned)
        finish(link, entry, status, actual_length);
    else if (number && entry->got)
        append(&link->unread[number], entry);
    else
        free_entry(entry);
    bool holds = abandoned && holds_back(link, endpoint);
    pthread_mutex_unlock(&link->lock);
    if (holds)
        send_held(link, endpoint);
}

/* What is not an answer to anything, or more than was asked for, ends the connection. */
static bool receive_answer(struct link *link)
{
    struct usbip_return answer;
    if (!usbip_receive_return(link->sock, &answer))
        return false;
    bool unlinked = answer.kind == USBIP_UNLINKED;
    if (unlinked && answer.status == 0)
        return true; /* too late to cancel: it has been answered */
    pthread_mutex_lock(&link->lock);
    struct entry *entry = find_pending(link, &answer);
    bool fits = entry && answer.actual_length <= entry->room, is_in = fits && entry->endpoint & IN;
    pthread_mutex_unlock(&link->lock);
    if (!fits || (is_in && !receive_data(link, entry, answer.actual_length)))
        return false;
    conclude(link, entry, unlinked ? -ENOENT : answer.status, answer.actual_length);
    return true;
}

void *read_answers(void *argument)
{
    struct link *link = argument;
    while (receive_answer(link))
        continue;
    shutdown(link->sock, SHUT_RDWR);
    pthread_mutex_lock(&link->lock);
    for (struct entry *entry; (entry = take(&link->pending, &link->pending.first));)
        if (entry->abandoned)
            free_entry(entry);
        else
            finish(link, entry, -ESHUTDOWN, 0);
    link->gone = true;
    pthread_cond_broadcast(&link->answered);
    real_close(link->drain);
    pthread_mutex_unlock(&link->lock);
    return NULL;
}
