//! The border as a host sees it: descriptions, outputs, failures, and panics that stay on their side.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::cell::RefCell;
use std::ffi::c_void;

use heartian_plugin::abi::{
    HEARTIAN_CANCELLED, HEARTIAN_FAILED, HEARTIAN_OK, HeartianBytes, HeartianCall, HeartianDescribe, HeartianInput,
};
use heartian_plugin::{Call, Error, Inputs, Kind, Node, Outputs, Port, entry, params};

params! {
    /// Behaves as it is told.
    pub struct Told {
        /// What to do.
        deed: String = "echo".to_owned(), choices(&["echo", "panic", "fail", "cancel", "stray"]);
        /// How loud.
        level: f32 = 0.5, unit("dB"), range(0.0, f64::INFINITY);
        /// Does not matter.
        threads: Vec<u32> = vec![1], unkeyed();
    }
}

impl Node for Told {
    const KIND: &'static str = "Told";
    const REVISION: u32 = 3;
    const INPUTS: &'static [Port] = &[Port::many("in", "org.example.a/1", "Joined.").optional()];
    const OUTPUTS: &'static [Port] = &[Port::one("out", "org.example.b/2", "All of it.")];

    fn run(&self, inputs: &Inputs<'_>, call: &Call) -> Result<Outputs, Error> {
        match self.deed.as_str() {
            "panic" => panic!("told to, at seed {}", call.seed()),
            "fail" => return Err(Error::new("told to").remedy("tell it otherwise").parameter("deed")),
            "cancel" => return Err(Error::cancelled()),
            "stray" => return Ok(Outputs::new().put("elsewhere", Vec::new())),
            _ => {}
        }
        Ok(Outputs::new().put("out", inputs.many("in").flat_map(|input| input.bytes.to_vec()).collect()))
    }
}

#[derive(Default)]
struct Heard {
    outputs: Vec<(String, String, Vec<u8>)>,
    said: Vec<String>,
}

thread_local! {
    static HEARD: RefCell<Heard> = RefCell::default();
}

fn text(bytes: HeartianBytes) -> String {
    // SAFETY: the bytes live for the call.
    String::from_utf8(unsafe { bytes.get() }.to_vec()).unwrap()
}

unsafe extern "C" fn write(_: *mut c_void, piece: HeartianBytes) {
    HEARD.with_borrow_mut(|heard| heard.said.push(text(piece)));
}

unsafe extern "C" fn fail_to_describe(_: *mut c_void, message: HeartianBytes, _: HeartianBytes) {
    HEARD.with_borrow_mut(|heard| heard.said.push(text(message)));
}

unsafe extern "C" fn emit(_: *mut c_void, port: HeartianBytes, artifact: HeartianBytes, bytes: HeartianBytes) -> i32 {
    // SAFETY: the bytes live for the call.
    let bytes = unsafe { bytes.get() }.to_vec();
    HEARD.with_borrow_mut(|heard| heard.outputs.push((text(port), text(artifact), bytes)));
    HEARTIAN_OK
}

unsafe extern "C" fn fail(_: *mut c_void, message: HeartianBytes, remedy: HeartianBytes, parameter: HeartianBytes) {
    HEARD.with_borrow_mut(|heard| heard.said.extend([message, remedy, parameter].map(text)));
}

static KINDS: &[Kind] = &[Kind::of::<Told>()];

/// Runs a node as a host would; `stride` as a later host with a longer struct would have it.
fn run(kind: &str, params: &str, inputs: &[&[u8]], stride: usize) -> (i32, Heard) {
    let bytes = |text: &str| HeartianBytes::of(text.as_bytes());
    let mut room = vec![0u64; (inputs.len() * stride).div_ceil(8)];
    for (index, input) in inputs.iter().enumerate() {
        let input =
            HeartianInput { port: bytes("in"), type_name: bytes("org.example.a/1"), bytes: HeartianBytes::of(input) };
        // SAFETY: the room is as long as all of them together.
        unsafe { room.as_mut_ptr().byte_add(index * stride).cast::<HeartianInput>().write_unaligned(input) };
    }
    let call = HeartianCall {
        size: size_of::<HeartianCall>() as u32,
        input_size: stride as u32,
        context: std::ptr::null_mut(),
        kind: bytes(kind),
        params: bytes(params),
        seed: 7,
        threads: 2,
        reserved: 0,
        inputs: room.as_ptr().cast(),
        input_count: inputs.len(),
        emit: Some(emit),
        fail: Some(fail),
    };
    // SAFETY: the call and all it points to live until it returns.
    let status = unsafe { entry::run(KINDS, &raw const call) };
    (status, HEARD.take())
}

#[test]
fn a_node_gets_its_inputs_whatever_the_host_appends_to_them() {
    for stride in [size_of::<HeartianInput>(), size_of::<HeartianInput>() + 24] {
        let (status, heard) = run("Told", "{}", &[b"ab", b"", b"c"], stride);
        assert_eq!(status, HEARTIAN_OK);
        assert_eq!(heard.outputs, [("out".to_owned(), "org.example.b/2".to_owned(), b"abc".to_vec())]);
    }
    let (status, heard) = run("Told", "{}", &[], size_of::<HeartianInput>());
    assert_eq!((status, heard.outputs[0].2.len()), (HEARTIAN_OK, 0));
}

#[test]
fn what_goes_wrong_is_said_and_nothing_crosses() {
    let size = size_of::<HeartianInput>();
    for (kind, params, wanted, words) in [
        ("Told", r#"{"deed": "panic"}"#, HEARTIAN_FAILED, "it panicked: told to, at seed 7"),
        ("Told", r#"{"deed": "fail"}"#, HEARTIAN_FAILED, "told to|tell it otherwise|deed"),
        ("Told", r#"{"deed": "cancel"}"#, HEARTIAN_CANCELLED, "cancelled"),
        ("Told", r#"{"deed": "stray"}"#, HEARTIAN_FAILED, "`elsewhere`"),
        ("Told", r#"{"dead": "x"}"#, HEARTIAN_FAILED, "unknown field `dead`"),
        ("Told", "", HEARTIAN_FAILED, "EOF"),
        ("Tell", "{}", HEARTIAN_FAILED, "no kind of node `Tell`"),
    ] {
        let (status, heard) = run(kind, params, &[b"x"], size);
        assert_eq!(status, wanted, "{params}");
        assert!(heard.said.join("|").contains(words) && heard.outputs.is_empty(), "{params}: {:?}", heard.said);
    }
}

#[test]
fn the_description_says_all_that_the_struct_says() {
    let call = HeartianDescribe {
        size: size_of::<HeartianDescribe>() as u32,
        reserved: 0,
        context: std::ptr::null_mut(),
        write: Some(write),
        fail: Some(fail_to_describe),
    };
    // SAFETY: the call lives until it returns.
    let status = unsafe { entry::describe(("mine", "1.2.3"), KINDS, &raw const call) };
    assert_eq!(status, HEARTIAN_OK);
    let document: serde_json::Value = serde_json::from_str(&HEARD.take().said.concat()).unwrap();
    assert_eq!(
        (&document["format"], &document["name"], &document["version"]),
        (&1.into(), &"mine".into(), &"1.2.3".into())
    );
    let kind = &document["kinds"][0];
    assert_eq!(
        (&kind["kind"], &kind["revision"], &kind["doc"]),
        (&"Told".into(), &3.into(), &"Behaves as it is told.".into())
    );
    assert_eq!((&kind["inputs"][0]["many"], &kind["inputs"][0]["required"]), (&true.into(), &false.into()));
    assert_eq!(kind["outputs"][0]["type"], "org.example.b/2");
    let level = &kind["params"][1];
    assert_eq!((&level["type"], &level["default"], &level["unit"]), (&"f32".into(), &0.5.into(), &"dB".into()));
    assert_eq!((&level["least"], &level["greatest"]), (&0.0.into(), &serde_json::Value::Null));
    let threads = &kind["params"][2];
    assert_eq!((&threads["type"], &threads["list"], &threads["keyed"]), (&"u32".into(), &true.into(), &false.into()));
}
