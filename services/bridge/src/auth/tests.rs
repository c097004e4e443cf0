use std::os::unix::fs::PermissionsExt as _;

use super::*;

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn codes_are_those_of_rfc_4231() {
    let cases: [(&[u8], &[u8], &str); 3] = [
        (&[0x0b; 20], b"Hi There", "b0344c61d8db38535ca8afceaf0bf12b881dc200c9833da726e9376c2e32cff7"),
        (
            b"Jefe",
            b"what do ya want for nothing?",
            "5bdcc146bf60754e6a042426089575c75a003f089d2739839dec58b964ec3843",
        ),
        (
            &[0xaa; 131],
            b"Test Using Larger Than Block-Size Key - Hash Key First",
            "60e431591ee0b67f0d8a26aacbf5b77f8e0bc6213728c5140546040f0ee37f54",
        ),
    ];
    for (key, text, expected) in cases {
        assert_eq!(hex(&hmac(key, &[text])), expected);
        let (start, end) = text.split_at(5);
        assert_eq!(hex(&hmac(key, &[start, b"", end])), expected);
    }
}

#[test]
fn codes_differ_by_purpose_and_by_key() {
    let (key, other) = (Key::new(vec![1; 32]), Key::new(vec![2; 32]));
    let session = key.session(b"a", b"b");
    let codes = [
        key.receiver_code(b"a", b"b"),
        other.receiver_code(b"a", b"b"),
        session.frame_code(b"ab"),
        session.ack_code(b"ab"),
        other.session(b"a", b"b").frame_code(b"ab"),
        key.session(b"a", b"c").frame_code(b"ab"),
    ];
    for (place, code) in codes.iter().enumerate() {
        assert!(codes[place + 1..].iter().all(|later| !is_equal(code, later)), "{place}");
        assert!(is_equal(code, code));
    }
}

#[test]
fn a_key_is_read_only_from_a_file_that_nobody_else_can_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("key");
    let write = |bytes: &[u8], mode: u32| {
        std::fs::write(&path, bytes).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
    };
    write(b"0123456789abcdef\n", 0o600);
    assert_eq!(Key::read(&path).unwrap().0, b"0123456789abcdef");
    write(b"0123456789abcdef", 0o400);
    assert_eq!(Key::read(&path).unwrap().0, b"0123456789abcdef");
    for mode in [0o640, 0o604, 0o620, 0o601] {
        write(b"0123456789abcdef", mode);
        let refused = Key::read(&path);
        assert!(matches!(refused, Err(KeyError::Mode(_, found)) if found == mode), "{refused:?}");
    }
    for bytes in [&b"0123456789abcde\n"[..], &[7; KEY_BYTES_MAX + 1], &[7; 1 << 20]] {
        write(bytes, 0o600);
        assert!(matches!(Key::read(&path), Err(KeyError::Length(..))));
    }
    let missing = Key::read(&folder.path().join("none")).unwrap_err().to_string();
    assert!(missing.contains("none: "), "{missing}");
}

#[test]
fn nonces_differ() {
    assert_ne!(nonce().unwrap(), nonce().unwrap());
}
