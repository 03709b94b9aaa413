/* Frames of self-built force plates for hilbrace: see serial_plate.md beside this folder.
 *
 * Plain C99 without memory allocation; runs on any microcontroller. Each function writes one whole frame into
 * `out` and returns its length; hand that to your serial port in one write.
 */
#ifndef HILBRACE_FRAME_H
#define HILBRACE_FRAME_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define HILBRACE_MOST_CHANNELS 32
#define HILBRACE_LONGEST_INFO 400

/* Payload, 4 bytes of CRC-32, byte stuffing (1 in 254, and 1), a zero at either end. */
#define HILBRACE_FRAME_SPACE(payload) ((payload) + 4 + ((payload) + 4) / 254 + 1 + 2)
#define HILBRACE_SAMPLE_SPACE HILBRACE_FRAME_SPACE(7 + 4 * HILBRACE_MOST_CHANNELS)
#define HILBRACE_INFO_SPACE HILBRACE_FRAME_SPACE(1 + HILBRACE_LONGEST_INFO)

/* CRC-32 of IEEE 802.3, half a byte at a time: a table of 64 bytes instead of 1024. */
static uint32_t hilbrace_crc32(const uint8_t *data, size_t size) {
    static const uint32_t table[16] = {
        0x00000000, 0x1db71064, 0x3b6e20c8, 0x26d930ac, 0x76dc4190, 0x6b6b51f4, 0x4db26158, 0x5005713c,
        0xedb88320, 0xf00f9344, 0xd6d6a3e8, 0xcb61b38c, 0x9b64c2b0, 0x86d3d2d4, 0xa00ae278, 0xbdbdf21c};
    uint32_t crc = 0xffffffff;
    for (size_t k = 0; k < size; k++) {
        crc = table[(crc ^ data[k]) & 15] ^ (crc >> 4);
        crc = table[(crc ^ (data[k] >> 4)) & 15] ^ (crc >> 4);
    }
    return ~crc;
}

static uint8_t *hilbrace_little_endian(uint8_t *at, uint32_t value, int bytes) {
    for (int k = 0; k < bytes; k++) *at++ = (uint8_t)(value >> (8 * k));
    return at;
}

/* `payload` must have room for 4 bytes behind its `size`. */
static size_t hilbrace_frame(uint8_t *payload, size_t size, uint8_t *out) {
    hilbrace_little_endian(payload + size, hilbrace_crc32(payload, size), 4);
    size += 4;
    uint8_t *at = out;
    *at++ = 0;
    uint8_t *distance = at++;
    *distance = 1;
    for (size_t k = 0; k < size; k++) {
        if (payload[k] != 0) {
            *at++ = payload[k];
            ++*distance;
        }
        if (payload[k] == 0 || (*distance == 255 && k + 1 < size)) {
            distance = at++;
            *distance = 1;
        }
    }
    *at++ = 0;
    return (size_t)(at - out);
}

/* One sample. `sequence` counts samples, `microseconds` is the clock when it was taken; both may wrap. */
static size_t hilbrace_sample(uint16_t sequence, uint32_t microseconds, const int32_t *counts, int channels,
                              uint8_t out[HILBRACE_SAMPLE_SPACE]) {
    uint8_t payload[7 + 4 * HILBRACE_MOST_CHANNELS + 4];
    uint8_t *at = payload;
    *at++ = 1;
    at = hilbrace_little_endian(at, sequence, 2);
    at = hilbrace_little_endian(at, microseconds, 4);
    for (int k = 0; k < channels; k++) at = hilbrace_little_endian(at, (uint32_t)counts[k], 4);
    return hilbrace_frame(payload, (size_t)(at - payload), out);
}

/* What the plate is, as JSON; at the start, once a second, and whenever a '?' arrives. 0 if it is too long. */
static size_t hilbrace_info(const char *json, uint8_t out[HILBRACE_INFO_SPACE]) {
    uint8_t payload[1 + HILBRACE_LONGEST_INFO + 4];
    size_t size = strlen(json);
    if (size > HILBRACE_LONGEST_INFO) return 0;
    payload[0] = 2;
    memcpy(payload + 1, json, size);
    return hilbrace_frame(payload, 1 + size, out);
}

/* The trigger input changed to `level` (0 or 1) at `microseconds`. */
static size_t hilbrace_edge(uint32_t microseconds, uint8_t level, uint8_t out[HILBRACE_FRAME_SPACE(6)]) {
    uint8_t payload[6 + 4];
    uint8_t *at = payload;
    *at++ = 3;
    at = hilbrace_little_endian(at, microseconds, 4);
    *at++ = level ? 1 : 0;
    return hilbrace_frame(payload, (size_t)(at - payload), out);
}

#endif
