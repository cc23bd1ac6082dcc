/* A complete plugin in plain C: counts how often each byte occurs in what it is given.
 *
 *   cc -shared -fPIC -O2 -I plugins/sdk/include plugins/c-histogram/histogram.c -o libhistogram.so
 *   heartian nodes ByteHistogram --plugin ./libhistogram.so
 *
 * Reads `org.heartian.blob/1` (the type of plugins/blob), writes a type of its own, `org.example.histogram/1`: 256 counts,
 * 64 bits each, little-endian. The host passes both on without knowing what they are.
 */
#include <stdio.h>
#include <stdlib.h>

#include "heartian_plugin.h"

static const char DESCRIPTION[] =
    "{\"format\": 1, \"name\": \"c-histogram\", \"version\": \"1.0.0\", \"kinds\": [{"
    "  \"kind\": \"ByteHistogram\", \"revision\": 1,"
    "  \"doc\": \"Counts how often each byte occurs.\","
    "  \"inputs\": [{\"name\": \"in\", \"type\": \"org.heartian.blob/1\", \"doc\": \"Bytes to count.\", \"many\": true}],"
    "  \"outputs\": [{\"name\": \"counts\", \"type\": \"org.example.histogram/1\", \"doc\": \"256 counts of 64 bits.\"}],"
    "  \"params\": [{\"name\": \"every\", \"type\": \"u32\", \"default\": 1, \"least\": 1, \"doc\": \"Counts every n-th byte.\"}]"
    "}]}";

static const HeartianProgressSuite *progress;

static int32_t describe(const HeartianDescribe *call) {
  call->write(call->context, heartian_text(DESCRIPTION));
  return HEARTIAN_OK;
}

/* The value of a whole-number parameter. The host has checked the JSON: every parameter stands in it, on one line. */
static uint64_t number(HeartianBytes params, const char *name) {
  char text[4096];
  char quoted[64];
  const char *found;
  if (params.size >= sizeof text) return 0;
  memcpy(text, params.data, params.size);
  text[params.size] = 0;
  snprintf(quoted, sizeof quoted, "\"%s\":", name);
  found = strstr(text, quoted);
  return found ? strtoull(found + strlen(quoted), NULL, 10) : 0;
}

static int32_t run(const HeartianCall *call) {
  uint64_t counts[256] = {0};
  uint8_t bytes[sizeof counts];
  uint64_t every = number(call->params, "every");
  if (every == 0) {
    call->fail(call->context, heartian_text("`every` is not set"), heartian_text("set it to 1 or more"),
               heartian_text("every"));
    return HEARTIAN_FAILED;
  }
  for (size_t index = 0; index < call->input_count; index++) {
    const HeartianInput *input = heartian_input(call, index);
    if (!heartian_is(input->port, "in")) continue;
    for (size_t at = 0; at < input->bytes.size; at += every) counts[input->bytes.data[at]]++;
    if (progress && progress->report(call->context, index + 1, call->input_count, heartian_text(""), 0.0))
      return HEARTIAN_CANCELLED;
  }
  for (size_t at = 0; at < sizeof bytes; at++) bytes[at] = (uint8_t)(counts[at / 8] >> (8 * (at % 8)));
  HeartianBytes out = {bytes, sizeof bytes};
  return call->emit(call->context, heartian_text("counts"), heartian_text("org.example.histogram/1"), out);
}

static const HeartianPlugin PLUGIN = {
    .magic = HEARTIAN_MAGIC,
    .size = sizeof(HeartianPlugin),
    .abi_major = HEARTIAN_ABI_MAJOR,
    .abi_minor = HEARTIAN_ABI_MINOR,
    .describe = describe,
    .run = run,
};

const HeartianPlugin *heartian_plugin_v1(const HeartianHost *host) {
  progress = host->suite(heartian_text("heartian.progress"), 1);
  return &PLUGIN;
}
