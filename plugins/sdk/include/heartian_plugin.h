/* Heartian's plugin ABI, made from plugins/abi/src/types.rs; do not edit.
 *
 * A plugin is a shared library that exports `heartian_plugin_v1`, declared at the end. The host calls it once and gets a
 * HeartianPlugin that lives as long as the process; a library is never unloaded. Every struct begins with its own size and
 * is only ever appended to within a major version. What one side allocated only that side frees: borrowed bytes are valid
 * for the call, and what is handed to a callback is copied before it returns. No exception may cross. Text is UTF-8.
 * plugins/README.md shows how a plugin is made; plugins/c-histogram is one. */
#ifndef HEARTIAN_PLUGIN_H
#define HEARTIAN_PLUGIN_H


#include <stddef.h>
#include <stdint.h>
#include <string.h>

// First field of `HeartianPlugin`: the bytes `HEARTIAN`, read as a little-endian number.
#define HEARTIAN_MAGIC 5638868834950661448

// Raised when old plugins can no longer be loaded. The entry symbol carries it too.
#define HEARTIAN_ABI_MAJOR 1

// Raised when something is appended. A host loads plugins of its own minor version and of all before.
#define HEARTIAN_ABI_MINOR 0

// All went well.
#define HEARTIAN_OK 0

// Something went wrong; `fail` was told what.
#define HEARTIAN_FAILED 1

// The plugin stopped because it was asked to.
#define HEARTIAN_CANCELLED 2

// Bytes borrowed for the length of a call. Text is UTF-8 without a terminating zero. `data` may be null when `size` is 0.
typedef struct HeartianBytes {
  // The first byte.
  const uint8_t *data;
  // How many bytes.
  size_t size;
} HeartianBytes;

// A request to describe.
typedef struct HeartianDescribe {
  // Size of this struct in the host's build.
  uint32_t size;
  // 0.
  uint32_t reserved;
  // To be passed to the callbacks.
  void *context;
  // Takes a piece of the document.
  void (*write)(void *context, struct HeartianBytes piece);
  // Takes the reason of a failure: what is wrong and, where not empty, what can be done about it.
  void (*fail)(void *context, struct HeartianBytes message, struct HeartianBytes remedy);
} HeartianDescribe;

// One value on one input port; a port that takes many has several, in the order of the graph.
typedef struct HeartianInput {
  // The port's name.
  struct HeartianBytes port;
  // The type of what it carries, `name/version`.
  struct HeartianBytes type_name;
  // The value's on-disk form: a safetensors file for the house's own types.
  struct HeartianBytes bytes;
} HeartianInput;

// A request to run a node. The callbacks may be called from any thread until `run` returns.
typedef struct HeartianCall {
  // Size of this struct in the host's build.
  uint32_t size;
  // Size of one element of `inputs` in the host's build: step through them by it.
  uint32_t input_size;
  // To be passed to the callbacks.
  void *context;
  // Which kind of node.
  struct HeartianBytes kind;
  // All its parameters, as a JSON object; checked by the host against the description.
  struct HeartianBytes params;
  // The graph's seed.
  uint64_t seed;
  // How many threads the node may use; must not change what it computes.
  uint32_t threads;
  // 0.
  uint32_t reserved;
  // The inputs.
  const struct HeartianInput *inputs;
  // How many inputs.
  size_t input_count;
  // Takes the value of one output port. Returns `HEARTIAN_OK`, or `HEARTIAN_FAILED` when the host refuses it, which
  // fails the node.
  int32_t (*emit)(void *context,
                  struct HeartianBytes port,
                  struct HeartianBytes type_name,
                  struct HeartianBytes bytes);
  // Takes the reason of a failure: what is wrong, and, where not empty, what can be done about it and which parameter
  // is at fault.
  void (*fail)(void *context,
               struct HeartianBytes message,
               struct HeartianBytes remedy,
               struct HeartianBytes parameter);
} HeartianCall;

// What a plugin is. The first five fields stand at the same place in every version there will be.
typedef struct HeartianPlugin {
  // `HEARTIAN_MAGIC`.
  uint64_t magic;
  // Size of this struct in the plugin's build.
  uint32_t size;
  // `HEARTIAN_ABI_MAJOR` of the plugin's build.
  uint32_t abi_major;
  // `HEARTIAN_ABI_MINOR` of the plugin's build.
  uint32_t abi_minor;
  // 0.
  uint32_t reserved;
  // Hands a JSON document that describes all kinds of nodes to `call->write`, in one or more pieces. Does no work,
  // reads no file, and says the same every time. Returns `HEARTIAN_OK` or `HEARTIAN_FAILED`.
  int32_t (*describe)(const struct HeartianDescribe *call);
  // Runs one node: a pure function of parameters, inputs and seed. May be called from several threads at once.
  // Returns `HEARTIAN_OK`, `HEARTIAN_FAILED` or `HEARTIAN_CANCELLED`.
  int32_t (*run)(const struct HeartianCall *call);
  // What the plugin offers beyond this version, by name and version; may be null.
  const void *(*suite)(struct HeartianBytes name, uint32_t version);
} HeartianPlugin;

// Suite `heartian.progress`, version 1: for nodes that take longer than a blink.
typedef struct HeartianProgressSuite {
  // Size of this struct in the host's build.
  uint32_t size;
  // 0.
  uint32_t reserved;
  // Reports `step` of `total` (0: unknown) and, where `metric` is not empty, a live figure. Returns 0, or 1 when the
  // user asked to stop: return `HEARTIAN_CANCELLED` soon. A node that reports is not taken for one that hangs.
  int32_t (*report)(void *context,
                    uint64_t step,
                    uint64_t total,
                    struct HeartianBytes metric,
                    double value);
} HeartianProgressSuite;

// Suite `heartian.log`, version 1: one line to the user.
typedef struct HeartianLogSuite {
  // Size of this struct in the host's build.
  uint32_t size;
  // 0.
  uint32_t reserved;
  // Tells the user one line, such as a doubtful input that is used all the same. It is kept with the result.
  void (*warn)(void *context, struct HeartianBytes text);
} HeartianLogSuite;

// What the host offers.
typedef struct HeartianHost {
  // Size of this struct in the host's build.
  uint32_t size;
  // The host's `HEARTIAN_ABI_MAJOR`.
  uint32_t abi_major;
  // The host's `HEARTIAN_ABI_MINOR`.
  uint32_t abi_minor;
  // An optional feature by name and version; null when this host does not have it. Valid as long as the process.
  const void *(*suite)(struct HeartianBytes name, uint32_t version);
} HeartianHost;

// The exported function. Returns the plugin, which lives as long as the process, or null when it cannot serve this host.
typedef const struct HeartianPlugin *(*HeartianEntry)(const struct HeartianHost *host);


#if defined(_WIN32)
#define HEARTIAN_EXPORT __declspec(dllexport)
#else
#define HEARTIAN_EXPORT __attribute__((visibility("default")))
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* The exported function. Returns the plugin, or NULL when it cannot serve this host. */
HEARTIAN_EXPORT const HeartianPlugin *heartian_plugin_v1(const HeartianHost *host);

#ifdef __cplusplus
}
#endif

/* Bytes of a zero-terminated text. */
static inline HeartianBytes heartian_text(const char *text) {
  HeartianBytes bytes = {(const uint8_t *)text, strlen(text)};
  return bytes;
}

/* Whether some bytes are this text. */
static inline int heartian_is(HeartianBytes bytes, const char *text) {
  return bytes.size == strlen(text) && (bytes.size == 0 || memcmp(bytes.data, text, bytes.size) == 0);
}

/* Input number `index` of a call. */
static inline const HeartianInput *heartian_input(const HeartianCall *call, size_t index) {
  return (const HeartianInput *)((const char *)call->inputs + index * call->input_size);
}

#endif /* HEARTIAN_PLUGIN_H */
