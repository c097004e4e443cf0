//! A small recording for the tests of verbs, and tests of the module.

use bytemuck::Zeroable as _;
use recording::{About, Event, Frame, Happened, Writer};
use wire::{Cause, Detection, DetectionsTopic, Forecast, Header, Hop, Quality, StageId};

use super::*;

const MS: u64 = 1_000_000;

/// Writes a recording of ten ticks; the forecasts of tick 7 are held, and the decoder dies before it.
pub fn write(path: &Path) {
    let mut writer = Writer::create(path, &About::default(), "{}").expect("the file can be written");
    let mut received_ns = 0;
    for seq in 0..10 {
        let released_ns = 1_000 * MS + seq * 80 * MS;
        let mut header =
            Header { released_ns, interval_ns: 80 * MS, ..Header::new(7, seq, (seq * 80 * MS) as i64) };
        header.counts.agents_len = 1;
        let detections = [Detection::zeroed()];
        writer.frame(&Frame::of::<DetectionsTopic>(&header, &detections, released_ns + 1));
        let mut now_ns = released_ns;
        for stage in &StageId::ALL[..7] {
            let is_link = (StageId::Localiser..StageId::Sampler).contains(stage);
            if seq == 7 && is_link {
                continue;
            }
            let incarnation = u32::from(*stage == StageId::Decoder && seq > 7);
            let (received_ns, started_ns) = (now_ns + 1_000, now_ns + 2_000);
            let finished_ns = started_ns + if seq == 7 { 60 * MS } else { 2 * MS };
            let sent_ns = finished_ns + 1_000;
            let stage = stage.number();
            header.push_hop(Hop { stage, incarnation, received_ns, started_ns, finished_ns, sent_ns });
            now_ns = sent_ns;
        }
        let (quality, cause) =
            if seq == 7 { (Quality::Held, Cause::Late) } else { (Quality::Learned, Cause::None) };
        let forecast = Forecast {
            id: 41,
            quality: quality as u32,
            cause: cause as u32,
            age_ns: if seq == 7 { 80 * MS } else { 0 },
            ..Forecast::zeroed()
        };
        if seq == 7 {
            let (stage, how) = ("decoder".to_owned(), "was killed by signal 9".to_owned());
            writer.event(&Event { at_ns: released_ns, what: Happened::Died { stage, how, next: 1 } });
        }
        // Forecasts are received in the order of their ticks.
        received_ns = now_ns.max(received_ns + 1);
        writer.frame(&Frame::of::<wire::ForecastsTopic>(&header, &[forecast], received_ns));
    }
    writer.finish("the end").expect("the file can be written");
}

#[test]
fn a_recording_that_is_cut_off_is_used_as_far_as_it_goes() {
    let folder = std::env::temp_dir().join(format!("stgdat_recorded_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder can be made");
    let path = folder.join("a.mcap");
    write(&path);
    assert!(open(&path).is_ok_and(|recording| recording.is_complete()));
    let bytes = std::fs::read(&path).expect("it was written");
    std::fs::write(&path, &bytes[..bytes.len() - 100]).expect("a file can be written");
    assert!(open(&path).is_ok_and(|recording| !recording.is_complete()));
    assert!(open(&folder.join("b.mcap")).is_err());
    std::fs::remove_dir_all(folder).expect("the folder is ours");
}
