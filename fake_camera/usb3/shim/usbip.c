/* USB/IP as its clients speak it; Linux documents it in Documentation/usb/usbip_protocol.rst. */
#define _GNU_SOURCE
#include "shim.h"

#include <arpa/inet.h>
#include <errno.h>
#include <poll.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/un.h>
#include <time.h>

enum { HEADER_BYTES = 48 };
enum { VERSION = 0x0111, REQUEST_IMPORT = 0x8003, BUS_ID_BYTES = 32, DEVICE_BYTES = 312 };
enum { SUBMIT = 1, UNLINK = 2, RETURN_SUBMIT = 3, RETURN_UNLINK = 4 };
enum { CLAIM = 0x0AE1, RETURN_CLAIM = 0x0AE2 }; /* not part of USB/IP: see fake_camera/usb3/usbip/messages.py */
enum { PATIENCE_MS = 2000, MOST_ERRNO = 4095 };

struct header {
    uint32_t command, sequence, device, direction, endpoint;
    uint32_t words[5]; /* of Submit: flags, length, start frame, packets, interval; others use at most the first */
    unsigned char setup[8];
};
_Static_assert(sizeof(struct header) == HEADER_BYTES, "the header has no gaps");

static bool send_all(int sock, struct iovec *parts, int count)
{
    while (count > 0) {
        struct msghdr message = {.msg_iov = parts, .msg_iovlen = (size_t)count};
        ssize_t sent = sendmsg(sock, &message, MSG_NOSIGNAL);
        if (sent < 0 && errno == EINTR)
            continue;
        if (sent < 0)
            return false;
        while (count > 0 && (size_t)sent >= parts->iov_len) {
            sent -= (ssize_t)parts->iov_len;
            parts++, count--;
        }
        if (count > 0) {
            parts->iov_base = (char *)parts->iov_base + sent;
            parts->iov_len -= (size_t)sent;
        }
    }
    return true;
}

static int64_t now_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * INT64_C(1000) + now.tv_nsec / 1000000;
}

/* Wait until something can be received, or until a time (0: for ever). */
static bool wait_readable(int sock, int64_t until_ms)
{
    struct pollfd watched = {.fd = sock, .events = POLLIN};
    for (;;) {
        int64_t left_ms = until_ms ? until_ms - now_ms() : -1;
        if (until_ms && left_ms <= 0)
            return false;
        int ready = poll(&watched, 1, (int)left_ms);
        if (ready > 0)
            return true;
        if (ready < 0 && errno != EINTR)
            return false;
    }
}

static bool receive_until(int sock, void *data, size_t bytes, int64_t until_ms)
{
    for (char *at = data; bytes > 0;) {
        size_t got = 0;
        if (!wait_readable(sock, until_ms) || !usbip_receive_some(sock, at, bytes, &got))
            return false;
        at += got;
        bytes -= got;
    }
    return true;
}

bool usbip_wait(int sock)
{
    return wait_readable(sock, 0);
}

bool usbip_receive_some(int sock, void *data, size_t bytes, size_t *got)
{
    ssize_t received = recv(sock, data, bytes, MSG_DONTWAIT);
    *got = received > 0 ? (size_t)received : 0;
    return received > 0 || (received < 0 && (errno == EAGAIN || errno == EINTR));
}

/* Connect, ask for the camera, and hear that it is ours, which is to happen until a time. */
static bool import(int sock, const struct sockaddr_un *address, int64_t until_ms)
{
    struct {
        uint16_t version, code;
        uint32_t status;
        char bus_id[BUS_ID_BYTES];
    } request = {htons(VERSION), htons(REQUEST_IMPORT), 0, "1-1"};
    unsigned char reply[8 + DEVICE_BYTES];
    return connect(sock, (const struct sockaddr *)address, sizeof *address) == 0
        && send_all(sock, &(struct iovec){&request, sizeof request}, 1)
        && receive_until(sock, reply, 8, until_ms)
        && memcmp(reply + 4, "\0\0\0\0", 4) == 0
        && receive_until(sock, reply + 8, DEVICE_BYTES, until_ms);
}

int usbip_import(const char *path)
{
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    if (strlen(path) >= sizeof address.sun_path) {
        complain("the socket path %s is too long", path);
        return -1;
    }
    strcpy(address.sun_path, path);
    int sock = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (sock < 0)
        return -1;
    struct timeval patience = {.tv_sec = PATIENCE_MS / 1000}; /* also of connect, when the server's queue is full */
    setsockopt(sock, SOL_SOCKET, SO_SNDTIMEO, &patience, sizeof patience);
    if (import(sock, &address, now_ms() + PATIENCE_MS))
        return sock;
    real_close(sock);
    return -1;
}

bool usbip_send_submit(int sock, const struct usbip_submit *submit)
{
    bool in = submit->endpoint & 0x80;
    struct header header = {
        .command = htonl(SUBMIT),
        .sequence = htonl(submit->sequence),
        .direction = htonl(in),
        .endpoint = htonl(submit->endpoint & 0x0F),
        .words = {0, htonl(submit->length), 0, htonl(0xFFFFFFFF), 0},
    };
    if (submit->setup)
        memcpy(header.setup, submit->setup, sizeof header.setup);
    struct iovec parts[] = {{&header, sizeof header}, {(void *)submit->data, in ? 0 : submit->length}};
    return send_all(sock, parts, 2);
}

bool usbip_send_unlink(int sock, uint32_t sequence, uint32_t unlinked)
{
    struct header header = {.command = htonl(UNLINK), .sequence = htonl(sequence), .words = {htonl(unlinked)}};
    return send_all(sock, &(struct iovec){&header, sizeof header}, 1);
}

bool usbip_send_claim(int sock, uint32_t sequence, uint8_t interface, bool claims)
{
    struct header header = {
        .command = htonl(CLAIM),
        .sequence = htonl(sequence),
        .direction = htonl(claims),
        .endpoint = htonl(interface),
    };
    return send_all(sock, &(struct iovec){&header, sizeof header}, 1);
}

static bool receive_return(int sock, struct usbip_return *answer, int64_t until_ms)
{
    struct header header;
    if (!receive_until(sock, &header, sizeof header, until_ms))
        return false;
    answer->sequence = ntohl(header.sequence);
    answer->status = (int)ntohl(header.words[0]);
    answer->actual_length = 0;
    if (!answer->sequence || answer->status > 0 || answer->status < -MOST_ERRNO)
        return false; /* no request has this number, or no error */
    switch (ntohl(header.command)) {
    case RETURN_SUBMIT:
        answer->kind = USBIP_SUBMITTED;
        answer->actual_length = ntohl(header.words[1]);
        return true;
    case RETURN_UNLINK:
        answer->kind = USBIP_UNLINKED;
        return true;
    case RETURN_CLAIM:
        answer->kind = USBIP_CLAIMED;
        return true;
    default:
        return false;
    }
}

bool usbip_receive_return(int sock, struct usbip_return *answer)
{
    return receive_return(sock, answer, 0);
}

long usbip_ask(int sock, uint16_t value, void *data, uint16_t bytes)
{
    enum { GET_DESCRIPTOR = 6 };
    unsigned char setup[8] = {0x80, GET_DESCRIPTOR, value & 0xFF, value >> 8, 0, 0, bytes & 0xFF, bytes >> 8};
    struct usbip_submit submit = {.sequence = 1, .endpoint = 0x80, .length = bytes, .setup = setup};
    struct usbip_return answer;
    int64_t until_ms = now_ms() + PATIENCE_MS;
    if (!usbip_send_submit(sock, &submit) || !receive_return(sock, &answer, until_ms) || answer.status != 0
        || answer.actual_length > bytes || !receive_until(sock, data, answer.actual_length, until_ms))
        return -1;
    return answer.actual_length;
}
