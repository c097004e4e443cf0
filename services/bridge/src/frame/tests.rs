use wire::{AGENTS_MAX, Cause, DETECTIONS_MAX, Detection, Forecast, Header, Quality, WorldOrigin};

use super::*;
use crate::auth::Key;

fn session() -> Session {
    Key::new(vec![7; 32]).session(b"sender", b"receiver")
}

fn header() -> Header {
    let mut header = Header::new(0x1234, 56, 7_000_000_000);
    (header.step_ns, header.counts.horizon_len) = (400_000_000, 12);
    (header.ego_m, header.ego_heading_rad) = ([1.25, -2.5], 0.5);
    header.flags = wire::flags::SEEN_FROM_EGO | wire::flags::LOCKSTEP;
    header
}

/// A forecast whose mode `m` moves by (1, m) m at each step.
fn forecast(id: u64) -> Forecast {
    let mut forecast = Forecast {
        id,
        age_ns: 160_000_000,
        quality: Quality::Held as u32,
        cause: Cause::Late as u32,
        causes: Cause::Late.bit(),
        modes_len: 6,
        x_m: 32_000.004,
        y_m: -20.0,
        vx_mps: 2.5,
        vy_mps: -119.0,
        heading_rad: -3.125,
        length_m: 4.25,
        ..Zeroable::zeroed()
    };
    for step in 0..12 {
        let x_m = forecast.x_m + (step + 1) as f32;
        forecast.best[step] = [x_m, -20.0];
        for mode in 0..6 {
            forecast.modes[mode][step] = [x_m, -20.0 + (mode * (step + 1)) as f32];
        }
    }
    forecast.probability[..6].copy_from_slice(&[0.1, 0.3, 0.05, 0.3, 0.2, 0.05]);
    forecast
}

fn body(forecasts: &[Forecast], modes_max: usize) -> Vec<u8> {
    let mut body = Vec::new();
    let origin = WorldOrigin::new([458_000.0, 5_428_000.5]).unwrap();
    forecasts::write(&mut body, &TickHead::of(&header(), origin), forecasts, modes_max);
    body
}

#[test]
fn forecasts_come_back_in_centimetres_with_their_likeliest_modes() {
    let found = forecasts::read(&body(&[forecast(5), forecast(6)], 3)).unwrap();
    let TickHead { run_id, seq, stamp_ns, interval_ns, .. } = found.head;
    assert_eq!((run_id, seq, stamp_ns, interval_ns), (0x1234, 56, 7_000_000_000, 400_000_000));
    assert_eq!((found.head.origin_m, found.head.ego_m), ([458_000.0, 5_428_000.5], [1.25, -2.5]));
    assert_eq!((found.head.flags, found.head.left_out_len), (wire::flags::SEEN_FROM_EGO, 0));
    let [first, second] = &found.agents[..] else { panic!("{found:?}") };
    assert_eq!((first.head.id, second.head.id, first.head.age_us), (5, 6, 160_000));
    assert_eq!((first.head.quality, first.head.cause, first.head.causes), (1, 1, 2));
    assert_eq!((first.head.x_cm, first.head.y_cm), (3_200_000, -2_000));
    assert_eq!((first.head.vx_cmps, first.head.vy_cmps, first.head.heading), (250, -11_900, -31_250));
    assert_eq!((first.head.length_cm, first.head.width_cm), (425, 0));
    assert_eq!(first.best[11], [3_201_200, -2_000]);
    let likeliest: Vec<(u16, [i32; 2])> = first.modes.iter().map(|(p, path)| (*p, path[11])).collect();
    // Modes 1, 3 and 4.
    let expected = [(19_661, -800), (19_661, 1_600), (13_107, 2_800)];
    assert_eq!(likeliest, expected.map(|(probability, y_cm)| (probability, [3_201_200, y_cm])));
}

#[test]
fn a_frame_has_at_most_five_modes_and_its_limit_of_bytes() {
    let all = vec![forecast(1); AGENTS_MAX + 2];
    let full = body(&all, 20);
    assert_eq!(full.len(), forecasts::BODY_BYTES_MAX);
    let found = forecasts::read(&full).unwrap();
    assert_eq!((found.agents.len(), found.head.left_out_len, found.agents[0].modes.len()), (128, 2, 5));
    assert_eq!(body(&all, 3).len() - 72, 128 * 246);
}

#[test]
fn forecasts_that_cannot_be_written_are_left_out_and_counted() {
    let (mut far, mut broken, mut fast) = (forecast(1), forecast(2), forecast(3));
    far.modes[1][4][0] += 400.0;
    broken.best[2][1] = f32::NAN;
    fast.vx_mps = 400.0;
    let found = forecasts::read(&body(&[far, forecast(4), broken, fast], 3)).unwrap();
    assert_eq!((found.agents.len(), found.agents[0].head.id, found.head.left_out_len), (1, 4, 3));
}

#[test]
fn detections_come_back_exactly() {
    let detection = |id| Detection { id, x_m: 0.1, y_m: 1.0 / 3.0, score: 0.7, ..Detection::default() };
    let all: Vec<Detection> = (0..DETECTIONS_MAX as u64 + 3).map(detection).collect();
    let head = TickHead { seq: 4, stamp_ns: -5, interval_ns: 80_000_000, ..TickHead::default() };
    let mut body = Vec::new();
    detections::write(&mut body, &head, &all);
    assert_eq!(body.len(), detections::BODY_BYTES_MAX);
    let found = detections::read(&body).unwrap();
    assert_eq!(found.detections, all[..DETECTIONS_MAX]);
    assert_eq!((found.head.elements_len, found.head.left_out_len), (512, 3));
    detections::write(&mut body, &head, &[Detection { x_m: f32::NAN, ..detection(1) }]);
    assert!(matches!(detections::read(&body), Err(Refused::Value(_))));
}

fn sealed(session: &Session, counter: u64) -> Vec<u8> {
    let mut frame = Vec::new();
    begin(&mut frame, &Envelope::new(Kind::Forecasts, counter), &body(&[forecast(5)], 3));
    seal(&mut frame, session);
    frame
}

#[test]
fn a_frame_opens_only_in_its_session_and_at_its_place() {
    let (session, frame) = (session(), sealed(&session(), 9));
    let (envelope, found) = open(&frame, &session, 9).unwrap();
    assert_eq!((envelope.length as usize, found), (frame.len(), &body(&[forecast(5)], 3)[..]));
    let other = Key::new(vec![8; 32]).session(b"sender", b"receiver");
    assert_eq!(open(&frame, &other, 9), Err(Refused::Code));
    let later = Key::new(vec![7; 32]).session(b"later", b"receiver");
    assert_eq!(open(&frame, &later, 9), Err(Refused::Code));
    for expected in [8, 10] {
        assert_eq!(open(&frame, &session, expected), Err(Refused::Counter { found: 9, expected }));
    }
}

#[test]
fn every_flipped_bit_and_every_cut_is_refused() {
    let (session, frame) = (session(), sealed(&session(), 1));
    for bit in 0..8 * frame.len() {
        let mut frame = frame.clone();
        frame[bit / 8] ^= 1 << (bit % 8);
        assert!(open(&frame, &session, 1).is_err(), "bit {bit}");
    }
    for length in 0..frame.len() {
        assert!(open(&frame[..length], &session, 1).is_err(), "{length} bytes");
    }
}

/// A frame that was changed before it was protected, as by a fault in the sender's memory.
#[test]
fn the_check_value_is_that_of_zlib_and_is_verified_without_the_code() {
    let session = session();
    let mut frame = sealed(&session, 1);
    frame.truncate(frame.len() - CODE_BYTES);
    let crc = u32::from_le_bytes(frame[12..16].try_into().unwrap());
    assert_eq!(crc, crc32fast::hash(&frame[16..]));
    frame[60] ^= 1;
    let code = session.frame_code(&frame);
    frame.extend_from_slice(&code);
    assert!(matches!(open(&frame, &session, 1), Err(Refused::CheckValue { .. })));
}

#[test]
fn impossible_lengths_and_other_versions_are_refused_before_the_body() {
    let envelope = |change: fn(&mut Envelope)| {
        let mut envelope = Envelope::new(Kind::Forecasts, 1);
        envelope.length = 1_000;
        change(&mut envelope);
        Envelope::read(bytes_of(&envelope).try_into().unwrap())
    };
    assert!(envelope(|_| ()).is_ok());
    assert_eq!(envelope(|e| e.magic[3] = b'X'), Err(Refused::Magic));
    assert_eq!(envelope(|e| e.version = 2), Err(Refused::Version(2)));
    for (length, change) in [
        (63, (|e| e.length = 63) as fn(&mut Envelope)),
        (65_537, |e| e.length = 65_537),
        (u64::from(u32::MAX), |e| e.length = u32::MAX),
    ] {
        assert_eq!(envelope(change), Err(Refused::Length { field: "length", found: length }));
    }
    let found = Kind::Detections as u16;
    assert_eq!(check_hello(MAGIC, 1, found, Kind::Detections), Ok(()));
    assert_eq!(check_hello(MAGIC, 1, found, Kind::Forecasts), Err(Refused::Kind { found, expected: 1 }));
}

#[test]
fn bodies_of_random_bytes_are_refused_without_a_panic() {
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut random = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let valid = body(&[forecast(5), forecast(6)], 3);
    for _ in 0..20_000 {
        let mut bytes = valid.clone();
        for _ in 0..random() % 8 {
            let place = random() as usize % bytes.len();
            bytes[place] = random() as u8;
        }
        bytes.truncate(valid.len() - (random() % 3) as usize * (random() as usize % 40));
        let _ = forecasts::read(&bytes);
        let _ = detections::read(&bytes);
    }
    for counted in [AGENTS_MAX as u16 + 1, u16::MAX] {
        let mut bytes = valid.clone();
        bytes[64..66].copy_from_slice(&counted.to_le_bytes());
        let refused = Refused::Length { field: "elements_len", found: counted.into() };
        assert_eq!(forecasts::read(&bytes), Err(refused));
    }
}
