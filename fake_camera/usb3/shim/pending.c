/* The queues of what waits for a camera's answers. */
#define _GNU_SOURCE
#include "pending.h"

#include <errno.h>
#include <linux/usbdevice_fs.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

void append(struct queue *queue, struct entry *entry)
{
    entry->next = NULL;
    *queue->end = entry;
    queue->end = &entry->next;
}

struct entry *take(struct queue *queue, struct entry **at)
{
    struct entry *entry = *at;
    if (entry && !(*at = entry->next))
        queue->end = at;
    return entry;
}

void remove_entry(struct queue *queue, struct entry *entry)
{
    for (struct entry **at = &queue->first; *at; at = &(*at)->next)
        if (*at == entry) {
            take(queue, at);
            return;
        }
}

void free_entry(struct entry *entry)
{
    free(entry->data);
    free(entry);
}

size_t skipped_bytes(const struct usbdevfs_urb *urb)
{
    return urb->type == USBDEVFS_URB_TYPE_CONTROL ? SETUP_BYTES : 0;
}

void finish(struct link *link, struct entry *entry, int status, size_t actual_length)
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

bool holds_back(const struct link *link, unsigned char endpoint)
{
    for (const struct entry *entry = link->pending.first; entry; entry = entry->next)
        if (entry->endpoint == endpoint && (entry->abandoned || !entry->sequence))
            return true;
    return false;
}

bool read_unread(struct link *link, struct entry *entry)
{
    struct queue *unread = &link->unread[entry->endpoint & 0x0F];
    struct entry *from = unread->first;
    if (!(entry->endpoint & IN) || !from)
        return false;
    size_t bytes = entry->room < from->got ? entry->room : from->got;
    memcpy(entry->urb->buffer, from->data, bytes);
    memmove(from->data, from->data + bytes, from->got -= bytes);
    if (!from->got)
        free_entry(take(unread, &unread->first));
    finish(link, entry, 0, bytes);
    return true;
}

struct usbip_submit numbered(struct link *link, struct entry *entry)
{
    const struct usbdevfs_urb *urb = entry->urb;
    entry->sequence = ++link->sequence;
    return (struct usbip_submit){
        .sequence = entry->sequence,
        .endpoint = entry->endpoint,
        .length = (uint32_t)entry->room,
        .setup = skipped_bytes(urb) ? urb->buffer : NULL,
        .data = (char *)urb->buffer + skipped_bytes(urb),
    };
}
