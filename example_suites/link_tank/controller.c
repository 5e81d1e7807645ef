/* A controller of a tank, at the other end of a link: percept in, command out.
 *
 * cc -O2 -o controller controller.c
 * ./controller               standard input and output: pipe:./controller
 * ./controller /dev/ttyUSB0  a serial line, which the system has set up: serial:/dev/...
 * ./controller 5000          UDP on this port of the loopback interface: udp:127.0.0.1:5000
 *
 * The frame stands in docs/link.md. It expects a little-endian machine with IEEE 754. */

#include <arpa/inet.h>
#include <fcntl.h>
#include <poll.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum { RESET = 1, PERCEPT, COMMAND, TICK, END };
enum { START = 24, LONGEST = 32768, IDLE_MS = 30000 };

static int input = 0, output = 1, is_socket = 0;
static struct sockaddr_in peer;
static uint32_t sent = 0;
static struct timespec begun;

static uint16_t crc16(const uint8_t *data, size_t size) {
    uint16_t crc = 0xFFFF;
    while (size--) {
        crc ^= (uint16_t)(*data++ << 8);
        for (int bit = 0; bit < 8; bit++)
            crc = (uint16_t)(crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1);
    }
    return crc;
}

static uint32_t crc32(const uint8_t *data, size_t size) {
    uint32_t crc = 0xFFFFFFFF;
    while (size--) {
        crc ^= *data++;
        for (int bit = 0; bit < 8; bit++) crc = crc & 1 ? (crc >> 1) ^ 0xEDB88320 : crc >> 1;
    }
    return ~crc;
}

static uint64_t microseconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    int64_t passed = (int64_t)(now.tv_sec - begun.tv_sec) * 1000000;
    return (uint64_t)(passed + (now.tv_nsec - begun.tv_nsec) / 1000);
}

static void put(const uint8_t *data, size_t size) {
    if (is_socket) {
        sendto(output, data, size, 0, (struct sockaddr *)&peer, sizeof peer);
        return;
    }
    while (size > 0) {
        ssize_t written = write(output, data, size);
        if (written <= 0) exit(1);
        data += written;
        size -= (size_t)written;
    }
}

static void send_frame(uint8_t kind, uint32_t answers, const void *payload, uint16_t length) {
    uint8_t frame[START + 64 + 4] = {0xD5, 0x5A, kind, 0};
    uint64_t stamp = microseconds();
    sent++;
    memcpy(frame + 4, &sent, 4);
    memcpy(frame + 8, &answers, 4);
    memcpy(frame + 12, &stamp, 8);
    memcpy(frame + 20, &length, 2);
    uint16_t check = crc16(frame, 22);
    memcpy(frame + 22, &check, 2);
    if (length) memcpy(frame + START, payload, length);
    uint32_t crc = crc32(frame, START + length);
    memcpy(frame + START + length, &crc, 4);
    put(frame, START + length + 4u);
}

/* The component: fills the tank up to a level, and stops a little before it. */
static double inflow_at(double level) {
    double inflow = 2.0 * (2.0 - level);
    return inflow < 0.0 ? 0.0 : inflow > 1.0 ? 1.0 : inflow;
}

static void take_frame(const uint8_t *frame) {
    uint32_t number;
    memcpy(&number, frame + 4, 4);
    if (frame[2] == RESET) {
        send_frame(RESET, number, NULL, 0);
    } else if (frame[2] == PERCEPT) {
        double level, inflow;
        memcpy(&level, frame + START, 8);
        inflow = inflow_at(level);
        send_frame(COMMAND, number, &inflow, 8);
    } else if (frame[2] == END) {
        exit(0);
    }
}

/* Takes the frames at the beginning of what has come; returns how many bytes are done with. */
static size_t take(const uint8_t *data, size_t size) {
    size_t at = 0;
    while (size - at >= START) {
        const uint8_t *frame = data + at;
        uint16_t length, check;
        uint32_t crc;
        memcpy(&length, frame + 20, 2);
        memcpy(&check, frame + 22, 2);
        if (frame[0] != 0xD5 || frame[1] != 0x5A || check != crc16(frame, 22) || length > LONGEST) {
            at++;
            continue;
        }
        if (size - at < START + length + 4u) break;
        memcpy(&crc, frame + START + length, 4);
        if (crc != crc32(frame, START + length)) {
            at++;
            continue;
        }
        take_frame(frame);
        at += START + length + 4u;
    }
    return at;
}

static void open_wire(const char *name) {
    int port = atoi(name);
    if (port > 0) {
        struct sockaddr_in own = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
        own.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        input = output = socket(AF_INET, SOCK_DGRAM, 0);
        is_socket = 1;
        if (bind(input, (struct sockaddr *)&own, sizeof own) != 0) exit(2);
        return;
    }
    struct termios raw;
    input = output = open(name, O_RDWR | O_NOCTTY);
    if (input < 0 || tcgetattr(input, &raw) != 0) exit(2);
    raw.c_lflag &= (tcflag_t) ~(ICANON | ECHO | ISIG | IEXTEN);
    raw.c_iflag &= (tcflag_t) ~(ICRNL | INLCR | IGNCR | IXON | ISTRIP);
    raw.c_oflag &= (tcflag_t)~OPOST;
    tcsetattr(input, TCSANOW, &raw);
}

int main(int count, char **arguments) {
    static uint8_t buffer[2 * LONGEST];
    size_t size = 0;
    clock_gettime(CLOCK_MONOTONIC, &begun);
    if (count > 1) open_wire(arguments[1]);
    for (;;) {
        struct pollfd waiting = {.fd = input, .events = POLLIN};
        socklen_t length = sizeof peer;
        if (poll(&waiting, 1, IDLE_MS) <= 0) return 0;
        ssize_t came = is_socket ? recvfrom(input, buffer + size, sizeof buffer - size, 0,
                                            (struct sockaddr *)&peer, &length)
                                 : read(input, buffer + size, sizeof buffer - size);
        if (came <= 0) return 0;
        size += (size_t)came;
        size_t done = take(buffer, size);
        memmove(buffer, buffer + done, size - done);
        size -= done;
    }
}
