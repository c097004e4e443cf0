//! The output of `stgdat wire` with compilers of C and C++, and with Python.

use std::path::Path;
use testing::Scratch;

use crate::started::{piped, run, run_well, stderr, stdout};

/// The module that the examples in Python use.
const EXAMPLES_MODULE: &str = include_str!("../examples/stgdat_wire.py");

/// Whether a program exists on this machine; prints a note if not.
fn is_here(program: &str) -> bool {
    let here = piped(program).arg("--version").output().is_ok_and(|output| output.status.success());
    if !here {
        testing::skip(format_args!("no {program} on this machine"));
    }
    here
}

/// Asserts that a program succeeds, and returns its output.
fn succeeds(command: &mut std::process::Command) -> String {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    assert!(output.status.success(), "{command:?}: {}", stderr(&output));
    stdout(&output)
}

/// The header itself asserts every offset and size.
#[test]
fn the_c_header_compiles_as_c_and_cpp() {
    let scratch = Scratch::new("wire-c");
    scratch.file("stgdat_wire.h", run_well(&["wire", "--c"]).stdout);
    let use_it = "#include \"stgdat_wire.h\"\n\
        stgdat_forecast forecast;\nfloat first(void);\nfloat first(void) { return forecast.modes[0][0][1]; }\n";
    for (compiler, standard, file) in [("cc", "c11", "use.c"), ("c++", "c++17", "use.cpp")] {
        if is_here(compiler) {
            let file = scratch.file(file, use_it);
            let flags = [&format!("-std={standard}"), "-Wall", "-Wextra", "-Werror", "-fsyntax-only"];
            succeeds(piped(compiler).args(flags).arg(file));
        }
    }
}

#[test]
fn the_python_module_of_the_examples_is_current() {
    let printed = stdout(&run_well(&["wire", "--python"]));
    assert!(
        printed == EXAMPLES_MODULE,
        "cargo run --release -- wire --python > tests/examples/stgdat_wire.py brings it up to date"
    );
}

/// The module itself asserts every offset and size when it is imported.
#[test]
fn the_python_module_imports_without_packages() {
    let python = std::env::var("STGDAT_PYTHON").unwrap_or_else(|_| "python3".into());
    if !is_here(&python) {
        return;
    }
    let scratch = Scratch::new("wire-python");
    scratch.file("stgdat_wire.py", EXAMPLES_MODULE);
    let script = "import stgdat_wire as w; f = w.Forecast; assert f.type_name() == 'stgdat.forecasts.2'\n\
        f = f(); f.modes[19][11][1] = 7.0; at = f.__class__.modes.offset + (19 * 12 + 11) * 8 + 4\n\
        import struct; assert struct.unpack('f', bytes(f)[at:at + 4]) == (7.0,)\n\
        d = w.DTYPES; assert not d or d[w.Forecast]['controls'].shape == (20,)\n";
    // First in isolation from installed packages, then with them.
    for isolated in [&["-I", "-S"][..], &[]] {
        let path = Path::new(&scratch.path("")).display().to_string();
        let script =
            format!("import sys; sys.dont_write_bytecode = True; sys.path.insert(0, {path:?})\n{script}");
        succeeds(piped(&python).args(isolated).args(["-c", &script]));
    }
}

/// A protected frame as header and payload, and the same frame with one flipped bit of the payload.
fn frames(scratch: &Scratch) -> [String; 3] {
    let mut header = wire::Header::new(7, 3, 240_000_000);
    header.counts.agents_len = 2;
    let payload = [5, 6].map(|id| wire::Detection { id, x_m: 1.5, ..wire::Detection::default() });
    header.protection = wire::Protection::of::<wire::DetectionsTopic>(&header, &payload, 9);
    let mut changed = payload;
    changed[1].id ^= 1;
    let files: [(&str, &[u8]); 3] = [
        ("header", bytemuck::bytes_of(&header)),
        ("payload", bytemuck::cast_slice(&payload)),
        ("changed", bytemuck::cast_slice(&changed)),
    ];
    files.map(|(name, bytes)| scratch.file(name, bytes))
}

#[test]
fn the_c_functions_protect_and_check_like_the_program() {
    if !is_here("cc") {
        return;
    }
    let scratch = Scratch::new("wire-c-check");
    scratch.file("stgdat_wire.h", run_well(&["wire", "--c"]).stdout);
    let source = scratch.file(
        "use.c",
        r#"#include "stgdat_wire.h"
#include <stdio.h>
#include <string.h>
static size_t contents(const char *path, void *into, size_t most) {
    FILE *file = fopen(path, "rb");
    const size_t length = fread(into, 1, most, file);
    fclose(file);
    return length;
}
int main(int count, char **paths) {
    static stgdat_header header, again;
    static char payload[4096], changed[4096];
    const uint32_t id = STGDAT_DETECTIONS_DATA_ID;
    if (count != 4 || contents(paths[1], &header, sizeof header) != sizeof header) return 2;
    const size_t length = contents(paths[2], payload, sizeof payload);
    if (contents(paths[3], changed, sizeof changed) != length) return 3;
    if (!stgdat_is_intact(&header, payload, length, id)) return 4;
    if (stgdat_is_intact(&header, changed, length, id)) return 5;
    if (stgdat_is_intact(&header, payload, length, STGDAT_TRACKS_DATA_ID)) return 6;
    again = header;
    memset(&again.protection, 0, sizeof again.protection);
    stgdat_protect(&again, payload, length, id, 9);
    return memcmp(&again, &header, sizeof header) ? 7 : 0;
}
"#,
    );
    let program = scratch.path("use");
    succeeds(piped("cc").args(["-std=c11", "-Wall", "-Wextra", "-Werror", "-o", &program]).arg(source));
    succeeds(piped(&program).args(frames(&scratch)));
}

#[test]
fn the_python_functions_protect_and_check_like_the_program() {
    let python = std::env::var("STGDAT_PYTHON").unwrap_or_else(|_| "python3".into());
    let has_lzma = || piped(&python).args(["-c", "import lzma"]).output().is_ok_and(|o| o.status.success());
    if !is_here(&python) || !has_lzma() {
        return;
    }
    let scratch = Scratch::new("wire-python-check");
    scratch.file("stgdat_wire.py", EXAMPLES_MODULE);
    let path = scratch.path("");
    let script = format!(
        "import sys; sys.dont_write_bytecode = True; sys.path.insert(0, {path:?})\n\
         import stgdat_wire as w\n\
         header, payload, changed = (open(path, 'rb').read() for path in sys.argv[1:])\n\
         header = w.Header.from_buffer_copy(header)\n\
         assert w.is_intact(header, payload, 'detections')\n\
         assert not w.is_intact(header, changed, 'detections')\n\
         assert not w.is_intact(header, payload, 'tracks')\n\
         again = w.Header.from_buffer_copy(header)\n\
         again.protection = w.Protection()\n\
         w.protect(again, payload, 'detections', 9)\n\
         assert bytes(again) == bytes(header)\n"
    );
    succeeds(piped(&python).args(["-c", &script]).args(frames(&scratch)));
}

#[test]
fn the_json_table_matches_the_program() {
    let table: serde_json::Value =
        serde_json::from_slice(&run_well(&["wire", "--json"]).stdout).expect("JSON");
    assert_eq!(table["schema"], wire::SCHEMA);
    let records = table["records"].as_array().expect("a list");
    let forecast = records.iter().find(|record| record["name"] == "Forecast").expect("there is one");
    assert_eq!(forecast["size"], size_of::<wire::Forecast>());
    let fields = forecast["fields"].as_array().expect("a list");
    let modes = fields.iter().find(|field| field["name"] == "modes").expect("there are some");
    assert_eq!(modes["offset"], std::mem::offset_of!(wire::Forecast, modes));
    assert_eq!(modes["type"]["len"], wire::MODES_MAX);
    assert_eq!(modes["type"]["array"]["array"]["array"], "f32");
    let topics = table["topics"].as_array().expect("a list");
    assert!(topics.iter().any(|topic| topic["type_name"] == "stgdat.forecasts.2"));
}

#[test]
fn wire_takes_one_language_at_a_time() {
    for arguments in [&["wire"][..], &["wire", "--c", "--json"]] {
        let output = run(arguments);
        assert!(!output.status.success() && stdout(&output).is_empty());
        assert!(stderr(&output).contains("--python") || stderr(&output).contains("cannot be used"));
    }
}
