/* What waits for a camera's answers, for pending.c, answers.c and link.c. */
#ifndef PENDING_H
#define PENDING_H

#include "shim.h"

#include <pthread.h>
#include <sys/types.h>

struct usbdevfs_urb;

enum { SETUP_BYTES = 8, ENDPOINTS = 16, IN = 0x80 };

/* What waits for an answer: an URB of libusb, or (`urb` is NULL) an ioctl that blocks until then, or what nobody waits
 * for any longer (`abandoned`): an URB that was discarded, or an ioctl that gave up. */
struct entry {
    struct entry *next;
    uint32_t sequence;        /* 0: it is held back, see `struct link` */
    uint32_t unlink_sequence; /* 0: it has not been discarded */
    struct usbdevfs_urb *urb;
    bool answered, abandoned;
    int status;
    unsigned char endpoint; /* with its direction bit */
    size_t room, got;       /* how many bytes may come, and have */
    unsigned char *data;    /* where they go when it is abandoned */
};

struct queue {
    struct entry *first, **end;
};

/* As with a host controller, an URB ends when it is discarded, whatever the camera does. What the camera sent for it
 * would then still be in the camera, so the next URB on that endpoint gets it from `unread`; until it is known whether
 * there is such data, that URB is held back. */
struct link {
    int fd, drain, sock; /* libusb's end of the pipe, ours, and the connection */
    pid_t owner;         /* the process that opened it, and not one that forked off */
    pthread_t reader;
    pthread_mutex_t sending;
    pthread_mutex_t lock; /* guards all below */
    pthread_cond_t answered;
    struct queue pending, done;
    struct queue unread[ENDPOINTS]; /* by the number of an IN endpoint: abandoned entries with data */
    uint32_t sequence;
    bool gone;
};

/* --- pending.c; the lock is held where a link is given --- */

void append(struct queue *queue, struct entry *entry);
struct entry *take(struct queue *queue, struct entry **at);
void remove_entry(struct queue *queue, struct entry *entry);
void free_entry(struct entry *entry);
size_t skipped_bytes(const struct usbdevfs_urb *urb);   /* of its buffer: the setup of a control transfer */
void finish(struct link *link, struct entry *entry, int status, size_t actual_length);
bool holds_back(const struct link *link, unsigned char endpoint); /* whether URBs there are held back, or are to be */
bool read_unread(struct link *link, struct entry *entry); /* complete an URB with what was sent for a discarded one */
struct usbip_submit numbered(struct link *link, struct entry *entry); /* the message, as it will be sent at once */

/* --- answers.c --- */

void check_sent(struct link *link, bool sent);
void *read_answers(void *link); /* a thread, until the connection ends */

#endif
