//! The C header is made from the Rust types and stands in the repository; this test makes it again and compares.
//! `HEARTIAN_UPDATE=1 cargo test -p heartian-plugin-abi` writes it.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::path::Path;

use cbindgen::{Builder, Config, DocumentationLength, DocumentationStyle, Language, Style};

const TOP: &str = "\
/* Heartian's plugin ABI, made from plugins/abi/src/types.rs; do not edit.
 *
 * A plugin is a shared library that exports `heartian_plugin_v1`, declared at the end. The host calls it once and gets a
 * HeartianPlugin that lives as long as the process; a library is never unloaded. Every struct begins with its own size and
 * is only ever appended to within a major version. What one side allocated only that side frees: borrowed bytes are valid
 * for the call, and what is handed to a callback is copied before it returns. No exception may cross. Text is UTF-8.
 * plugins/README.md shows how a plugin is made; plugins/c-histogram is one. */
#ifndef HEARTIAN_PLUGIN_H
#define HEARTIAN_PLUGIN_H
";

const END: &str = r#"
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
"#;

/// The header as the Rust types have it.
fn header() -> String {
    let config = Config {
        language: Language::C,
        header: Some(TOP.to_owned()),
        trailer: Some(END.to_owned()),
        sys_includes: ["stddef.h", "stdint.h", "string.h"].map(str::to_owned).into(),
        no_includes: true,
        style: Style::Both,
        documentation: true,
        documentation_style: DocumentationStyle::C99,
        documentation_length: DocumentationLength::Full,
        usize_is_size_t: true,
        cpp_compat: false,
        ..Config::default()
    };
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/types.rs");
    let names = ["HeartianPlugin", "HeartianProgressSuite", "HeartianLogSuite", "HeartianEntry"];
    let mut builder = Builder::new().with_config(config).with_src(source);
    for name in names {
        builder = builder.include_item(name);
    }
    let mut bytes = Vec::new();
    builder.generate().unwrap().write(&mut bytes);
    // `[`name`]` is how Rust's documentation links; C has no use for it.
    String::from_utf8(bytes).unwrap().replace("[`", "`").replace("`]", "`")
}

#[test]
fn the_header_is_what_the_types_say() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sdk/include/heartian_plugin.h");
    let header = header();
    for name in ["HeartianPlugin", "HeartianCall", "HeartianInput", "HEARTIAN_MAGIC", "HEARTIAN_ABI_MAJOR"] {
        assert!(header.contains(name), "{name} is missing:\n{header}");
    }
    if std::env::var_os("HEARTIAN_UPDATE").is_some() {
        std::fs::write(&path, &header).unwrap();
    }
    let found = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(found == header, "the header is out of date; run HEARTIAN_UPDATE=1 cargo test -p heartian-plugin-abi");
}
