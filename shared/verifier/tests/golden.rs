//! `verify` on the four golden folders, and on folders with errors.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use std::path::{Path, PathBuf};

use verifier::{VerifyError, verify};

fn golden(folder: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden").join(folder)
}

/// A copy of a golden folder whose file `name` was modified by `change`.
fn changed(folder: &str, name: &str, change: impl FnOnce(&mut Vec<u8>)) -> tempfile::TempDir {
    let copy = tempfile::tempdir().unwrap();
    for file in ["scene.json", "weights.safetensors", "tensors.safetensors"] {
        std::fs::copy(golden(folder).join(file), copy.path().join(file)).unwrap();
    }
    let path = copy.path().join(name);
    let mut bytes = std::fs::read(&path).unwrap();
    change(&mut bytes);
    std::fs::write(path, bytes).unwrap();
    copy
}

#[test]
fn every_tensor_of_every_folder_is_reproduced() {
    for folder in ["vehicle", "pedestrian", "plus", "literal"] {
        let rows = verify(&golden(folder)).unwrap();
        assert!(rows.len() > 35, "{folder}: {} tensors", rows.len());
        for row in rows {
            assert!(row.agrees(), "{folder}: {row:?}");
        }
    }
}

#[test]
fn one_changed_weight_is_noticed() {
    // The last number of the file is a weight of the last tensor, far from any header.
    let folder = changed("plus", "weights.safetensors", |bytes| {
        let last = bytes.len() - 4;
        bytes[last..].copy_from_slice(&3.0_f32.to_le_bytes());
    });
    let rows = verify(folder.path()).unwrap();
    assert!(rows.iter().any(|row| !row.agrees()), "a wrong weight went unnoticed");
}

#[test]
fn errors_of_broken_folders_name_the_file() {
    let missing = verify(Path::new("no/such/folder")).unwrap_err();
    assert!(matches!(missing, VerifyError::Unreadable { .. }), "{missing}");
    let truncated = changed("plus", "tensors.safetensors", |bytes| bytes.truncate(1000));
    let error = verify(truncated.path()).unwrap_err().to_string();
    assert!(error.contains("tensors.safetensors"), "{error}");
    let scene = changed("plus", "scene.json", |bytes| {
        *bytes = String::from_utf8(bytes.clone()).unwrap().replace("\"cyclist\"", "\"tram\"").into_bytes();
    });
    let error = verify(scene.path()).unwrap_err().to_string();
    assert!(error.contains("scene.json") && error.contains("tram"), "{error}");
}
