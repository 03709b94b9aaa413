// A self-built force plate for hilbrace: four load cells, 1000 samples a second, a trigger input on pin 2.
// Replace read_cells() by what reads your converter; the rest may stay. The frame is explained in
// serial_plate.md. Boards with native USB (Teensy, Pico, ESP32-S3) need no baud rate; others 921600, since a
// sample of eight channels has 46 bytes and 1000 of them a second fill 460 kbit/s.

#include "hilbrace_frame.h"

const uint32_t PERIOD_US = 1000;
const int CHANNELS = 4;
const int TRIGGER_PIN = 2;
const char INFO[] =
    "{\"name\":\"bench\",\"serial\":\"7\",\"rate_hz\":1000,\"channels\":[\"f1\",\"f2\",\"f3\",\"f4\"]}";

uint16_t sequence = 0;
uint32_t next_sample_us = 0, last_info_us = 0;
uint8_t trigger = 0;

void read_cells(int32_t counts[CHANNELS]) {
  for (int k = 0; k < CHANNELS; k++) counts[k] = analogRead(A0 + k);
}

void send_info() {
  uint8_t out[HILBRACE_INFO_SPACE];
  Serial.write(out, hilbrace_info(INFO, out));
  last_info_us = micros();
}

void setup() {
  pinMode(TRIGGER_PIN, INPUT);
  Serial.begin(921600);
  next_sample_us = micros();
  send_info();
}

void loop() {
  if (Serial.available() && Serial.read() == '?') send_info();
  if (micros() - last_info_us >= 1000000UL) send_info();

  uint8_t level = digitalRead(TRIGGER_PIN);
  if (level != trigger) {
    uint8_t out[HILBRACE_FRAME_SPACE(6)];
    trigger = level;
    Serial.write(out, hilbrace_edge(micros(), level, out));
  }

  if ((int32_t)(micros() - next_sample_us) >= 0) {
    int32_t counts[CHANNELS];
    uint8_t out[HILBRACE_SAMPLE_SPACE];
    uint32_t taken_us = micros();
    read_cells(counts);
    Serial.write(out, hilbrace_sample(sequence++, taken_us, counts, CHANNELS, out));
    next_sample_us += PERIOD_US;
  }
}
