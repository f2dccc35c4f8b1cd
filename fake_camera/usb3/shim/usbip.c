/* USB/IP as its clients speak it; Linux documents it in Documentation/usb/usbip_protocol.rst. */
#define _GNU_SOURCE
#include "shim.h"

#include <arpa/inet.h>
#include <errno.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/un.h>

enum { HEADER_BYTES = 48 };
enum { VERSION = 0x0111, REQUEST_IMPORT = 0x8003, BUS_ID_BYTES = 32, DEVICE_BYTES = 312 };
enum { SUBMIT = 1, UNLINK = 2, RETURN_SUBMIT = 3, RETURN_UNLINK = 4 };
enum { CLAIM = 0x0AE1, RETURN_CLAIM = 0x0AE2 }; /* not part of USB/IP: see fake_camera/usb3/usbip/messages.py */
enum { HANDSHAKE_S = 2 };

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

bool usbip_receive(int sock, void *data, size_t bytes)
{
    for (char *at = data; bytes > 0;) {
        ssize_t got = recv(sock, at, bytes, 0);
        if (got < 0 && errno == EINTR)
            continue;
        if (got <= 0)
            return false;
        at += got;
        bytes -= (size_t)got;
    }
    return true;
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
    struct timeval patience = {.tv_sec = HANDSHAKE_S};
    setsockopt(sock, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);

    struct {
        uint16_t version, code;
        uint32_t status;
        char bus_id[BUS_ID_BYTES];
    } request = {htons(VERSION), htons(REQUEST_IMPORT), 0, "1-1"};
    unsigned char reply[8 + DEVICE_BYTES];
    bool imported = connect(sock, (struct sockaddr *)&address, sizeof address) == 0
        && send_all(sock, &(struct iovec){&request, sizeof request}, 1)
        && usbip_receive(sock, reply, 8)
        && memcmp(reply + 4, "\0\0\0\0", 4) == 0
        && usbip_receive(sock, reply + 8, DEVICE_BYTES);
    patience.tv_sec = 0; /* for ever */
    setsockopt(sock, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    if (imported)
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

bool usbip_receive_return(int sock, struct usbip_return *answer)
{
    struct header header;
    if (!usbip_receive(sock, &header, sizeof header))
        return false;
    answer->sequence = ntohl(header.sequence);
    answer->status = (int)ntohl(header.words[0]);
    answer->actual_length = 0;
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

long usbip_ask(int sock, uint16_t value, void *data, uint16_t bytes)
{
    enum { GET_DESCRIPTOR = 6 };
    unsigned char setup[8] = {0x80, GET_DESCRIPTOR, value & 0xFF, value >> 8, 0, 0, bytes & 0xFF, bytes >> 8};
    struct usbip_submit submit = {.sequence = 1, .endpoint = 0x80, .length = bytes, .setup = setup};
    struct usbip_return answer;
    if (!usbip_send_submit(sock, &submit) || !usbip_receive_return(sock, &answer) || answer.status != 0
        || answer.actual_length > bytes || !usbip_receive(sock, data, answer.actual_length))
        return -1;
    return answer.actual_length;
}
