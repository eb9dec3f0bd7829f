/* Reads frames in hexadecimal, one per line; prints each after decoding and encoding it with the header. */
#include <stdio.h>
#include "mirrorball_base.h"

static unsigned size_of(uint8_t type)
{
    switch (type) {
    case MB_WHEEL_COMMAND: return sizeof(mb_wheel_command);
    case MB_TWIST_COMMAND: return sizeof(mb_twist_command);
    case MB_KICK_COMMAND: return sizeof(mb_kick_command);
    case MB_DRIBBLE_COMMAND: return sizeof(mb_dribble_command);
    case MB_ENCODERS: return sizeof(mb_encoders);
    case MB_POWER: return sizeof(mb_power);
    case MB_KICKER: return sizeof(mb_kicker);
    case MB_SWITCHES: return sizeof(mb_switches);
    case MB_INERTIA: return sizeof(mb_inertia);
    case MB_HEADING: return sizeof(mb_heading);
    default: return 0;
    }
}

int main(void)
{
    char line[512];
    while (fgets(line, sizeof line, stdin)) {
        mb_receiver receiver = {{0}, 0};
        uint8_t message[MB_FRAME_MAX], frame[MB_FRAME_MAX];
        unsigned value, length = 0, i, written;
        const char *text = line;
        while (length == 0 && sscanf(text, "%2x", &value) == 1) {
            length = mb_receive(&receiver, (uint8_t)value, message);
            text += 2;
        }
        if (length == 0) {
            puts("refused");
            continue;
        }
        if (length != size_of(message[1])) {
            printf("type %02x has %u bytes here\n", message[1], size_of(message[1]));
            continue;
        }
        written = mb_encode(message, length, (enum mb_type)message[1], frame);
        for (i = 0; i < written; i++)
            printf("%02x", frame[i]);
        puts("");
    }
    return 0;
}
