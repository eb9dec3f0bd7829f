/* Mirrorball's base-board protocol, version 1, for firmware in C99 or C++ on a little-endian processor.
 *
 * What the messages mean is told in wire.md; wire_vectors.csv holds one frame of each type to test against. A board needs:
 *   mb_encode()    a message -> a frame to send
 *   mb_receive()   received bytes, one by one -> messages
 * Nothing here allocates, and nothing needs more than the C library's memcpy.
 *
 * The rule that keeps a robot from running away: stop the wheels when `valid_ms` of the last WheelCommand or TwistCommand
 * has passed, whatever else arrives.
 */
#ifndef MIRRORBALL_BASE_H
#define MIRRORBALL_BASE_H

#include <stdint.h>
#include <string.h>

#define MB_VERSION 1
#define MB_PAYLOAD_MAX 60
#define MB_FRAME_MAX (MB_PAYLOAD_MAX + 4) /* checksum, one byte of COBS, closing zero */

enum mb_type {
    /* robot to board */
    MB_WHEEL_COMMAND = 0x01,
    MB_TWIST_COMMAND = 0x02,
    MB_KICK_COMMAND = 0x03,
    MB_DRIBBLE_COMMAND = 0x04,
    /* board to robot */
    MB_ENCODERS = 0x81,
    MB_POWER = 0x82,
    MB_KICKER = 0x83,
    MB_SWITCHES = 0x84,
    MB_INERTIA = 0x85,
    MB_HEADING = 0x86
};

/* Bits of mb_kicker.flags */
#define MB_KICKER_READY 1u
#define MB_KICKER_CHARGING 2u
#define MB_KICKER_BROKEN 4u
#define MB_KICKER_BALL 8u
/* Bits of mb_switches.flags */
#define MB_EMERGENCY_STOP 1u
#define MB_COMMAND_STALE 2u

#if defined(__GNUC__) || defined(__clang__)
#define MB_PACKED __attribute__((packed))
#else
#error "say how this compiler packs structures"
#endif
#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "the structures are little-endian"
#endif

/* Begins every message. `sequence` is counted by the sender over all it sends, wrapping. */
typedef struct MB_PACKED {
    uint8_t version;
    uint8_t type;
    uint16_t sequence;
} mb_header;

typedef struct MB_PACKED {
    mb_header header;
    uint16_t valid_ms;     /* stop the wheels so long after the arrival */
    uint8_t wheels;        /* refuse the command if this is not your number of wheels */
    uint8_t reserved;
    int16_t speed_crad[4]; /* 0.01 rad/s */
} mb_wheel_command;

typedef struct MB_PACKED {
    mb_header header;
    uint16_t valid_ms;
    int16_t forward_mm; /* mm/s */
    int16_t left_mm;    /* mm/s */
    int16_t turn_mrad;  /* mrad/s, counter-clockwise */
} mb_twist_command;

typedef struct MB_PACKED {
    mb_header header;
    uint16_t valid_ms; /* no kick later than this after the arrival */
    uint16_t speed_mm; /* mm/s */
    uint8_t lofted;    /* 0 along the ground, 1 lofted */
    uint8_t reserved;
} mb_kick_command;

typedef struct MB_PACKED {
    mb_header header;
    uint16_t valid_ms;
    int16_t left_drad;  /* 0.1 rad/s, positive pulls the ball in */
    int16_t right_drad;
} mb_dribble_command;

typedef struct MB_PACKED {
    mb_header header;
    uint32_t time_us;
    uint32_t count[4]; /* ticks since power-on, wrapping, all read at one time; 0 for wheels that are not there */
} mb_encoders;

typedef struct MB_PACKED {
    mb_header header;
    uint32_t time_us;
    uint16_t battery_mv;
    int16_t temperature_ddeg; /* hottest motor driver, 0.1 degrees Celsius */
    int16_t current_ca[4];    /* 0.01 A */
} mb_power;

typedef struct MB_PACKED {
    mb_header header;
    uint32_t time_us;
    uint16_t charge_dv; /* 0.1 V */
    uint8_t flags;
    uint8_t reserved;
    uint16_t last_kick; /* sequence number of the last kick command that was carried out */
} mb_kicker;

typedef struct MB_PACKED {
    mb_header header;
    uint32_t time_us;
    uint8_t bumpers; /* one bit each, from the front counter-clockwise */
    uint8_t flags;
} mb_switches;

typedef struct MB_PACKED {
    mb_header header;
    uint32_t time_us;
    int16_t acceleration_2mm[3]; /* specific force, 2 mm/s^2 */
    int16_t rate_mrad[3];        /* mrad/s */
} mb_inertia;

typedef struct MB_PACKED {
    mb_header header;
    uint32_t time_us;
    int16_t heading_dmrad; /* 0.1 mrad, counter-clockwise from magnetic north */
} mb_heading;

/* CRC-16/XMODEM: polynomial 0x1021, start 0, most significant bit first. */
static inline uint16_t mb_crc16(const uint8_t *bytes, unsigned length)
{
    uint16_t crc = 0;
    unsigned i;
    int bit;
    for (i = 0; i < length; i++) {
        crc = (uint16_t)(crc ^ ((uint16_t)bytes[i] << 8));
        for (bit = 0; bit < 8; bit++)
            crc = (uint16_t)((crc << 1) ^ (crc & 0x8000u ? 0x1021 : 0));
    }
    return crc;
}

/* Fills in version and type of `message` (which begins with an mb_header whose sequence is set), and writes its frame,
 * closing zero included. Returns the frame's length, 0 if the message is too long. */
static inline unsigned mb_encode(void *message, unsigned length, enum mb_type type, uint8_t frame[MB_FRAME_MAX])
{
    uint8_t payload[MB_PAYLOAD_MAX + 2];
    unsigned code = 0, out = 1, i;
    uint16_t crc;
    if (length < sizeof(mb_header) || length > MB_PAYLOAD_MAX)
        return 0;
    ((uint8_t *)message)[0] = MB_VERSION;
    ((uint8_t *)message)[1] = (uint8_t)type;
    memcpy(payload, message, length);
    crc = mb_crc16(payload, length);
    payload[length++] = (uint8_t)crc;
    payload[length++] = (uint8_t)(crc >> 8);
    for (i = 0; i < length; i++) {
        if (payload[i] == 0) {
            frame[code] = (uint8_t)(out - code);
            code = out++;
        } else {
            frame[out++] = payload[i];
        }
    }
    frame[code] = (uint8_t)(out - code);
    frame[out++] = 0;
    return out;
}

/* What has been received of a frame; begin with all zeros. */
typedef struct {
    uint8_t bytes[MB_FRAME_MAX];
    unsigned length;
} mb_receiver;

/* Takes one received byte. Returns the length of the message now standing in `message` (its type is in its header), or 0.
 * Frames with a wrong checksum, length or version are dropped; check the length against sizeof of the type's structure. */
static inline unsigned mb_receive(mb_receiver *receiver, uint8_t byte, uint8_t message[MB_FRAME_MAX])
{
    unsigned length = receiver->length, in = 0, out = 0, block;
    if (byte != 0) {
        if (length < MB_FRAME_MAX)
            receiver->bytes[length] = byte;
        receiver->length = length < MB_FRAME_MAX ? length + 1 : MB_FRAME_MAX;
        return 0;
    }
    receiver->length = 0;
    if (length >= MB_FRAME_MAX)
        return 0;
    while (in < length) {
        block = receiver->bytes[in++] - 1u;
        if (block > length - in)
            return 0;
        memcpy(message + out, receiver->bytes + in, block);
        out += block;
        in += block;
        if (in < length)
            message[out++] = 0;
    }
    if (out < sizeof(mb_header) + 2 || message[0] != MB_VERSION)
        return 0;
    out -= 2;
    if (mb_crc16(message, out) != (uint16_t)(message[out] | (message[out + 1] << 8)))
        return 0;
    return out;
}

#endif
