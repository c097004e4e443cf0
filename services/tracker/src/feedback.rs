//! Feedback from the newest forecasts, for the stages that select the agents of a tick.

use wire::{Forecast, Header, Quality, StageId, Track};

use crate::forecasts::Forecasts;

/// Writes feedback into a tick's header and tracks: the age and cost of the newest forecasts, and the age of
/// the newest learned forecast of each track. Without forecasts it writes nothing.
pub fn write(header: &mut Header, tracks: &mut [Track], newest: Option<(&Header, &[Forecast])>) {
    let Some((of, forecasts)) = newest.filter(|(of, _)| of.stamp_ns < header.stamp_ns) else { return };
    let Ok(Some(mut found)) = Forecasts::new(of, forecasts) else { return };
    let feedback_age_ns = header.stamp_ns.saturating_sub(of.stamp_ns).unsigned_abs();
    header.feedback_age_ns = feedback_age_ns;
    if let (Some(first), Some(last)) = (of.hop(StageId::Extractor), of.hop(StageId::Decoder)) {
        header.chain_ns = last.finished_ns.saturating_sub(first.finished_ns);
        header.chain_len = forecasts.iter().filter(|forecast| forecast.is_served()).count() as u32;
    }
    if let Some(hop) = of.hop(StageId::Sampler) {
        let took_ns = hop.finished_ns.saturating_sub(hop.started_ns);
        header.sampling_ns = u32::try_from(took_ns).unwrap_or(u32::MAX);
    }
    for track in tracks {
        let forecast = found.find(track.id);
        let age_ns =
            forecast.filter(|f| f.is_served() || f.quality == Quality::Held as u32).map(|f| f.age_ns);
        track.learned_age_ns = age_ns.map_or(0, |age_ns| age_ns.saturating_add(feedback_age_ns));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use wire::{Cause, Hop};

    const MS: u64 = 1_000_000;

    fn hop(stage: StageId, finished_ms: u64) -> Hop {
        Hop { stage: stage.number(), finished_ns: finished_ms * MS, ..Hop::default() }
    }

    #[test]
    fn ages_and_cost_are_those_of_the_newest_forecasts() {
        let forecast = |id, quality: Quality, cause: Cause, age_ms| Forecast {
            id,
            quality: quality as u32,
            cause: cause as u32,
            age_ns: age_ms * MS,
            ..Forecast::zeroed()
        };
        let forecasts = [
            forecast(1, Quality::Learned, Cause::None, 0),
            forecast(2, Quality::Held, Cause::Shed, 240),
            forecast(3, Quality::Kinematic, Cause::Outdone, 0),
            forecast(4, Quality::Kinematic, Cause::Shed, 0),
        ];
        let mut of = Header { step_ns: 400 * MS, ..Header::new(1, 7, 560 * MS as i64) };
        of.counts.horizon_len = 12;
        of.push_hop(hop(StageId::Extractor, 10));
        of.push_hop(hop(StageId::Decoder, 34));
        of.push_hop(Hop { started_ns: 35 * MS, ..hop(StageId::Sampler, 38) });
        let mut header = Header::new(1, 8, 640 * MS as i64);
        let mut tracks = [1, 2, 3, 4, 5].map(|id| Track { id, ..Track::zeroed() });
        write(&mut header, &mut tracks, Some((&of, &forecasts)));
        assert_eq!(tracks.map(|track| track.learned_age_ns / MS), [80, 320, 80, 0, 0]);
        assert_eq!((header.feedback_age_ns, header.chain_ns, header.chain_len), (80 * MS, 24 * MS, 2));
        assert_eq!(u64::from(header.sampling_ns), 3 * MS);
        // The clock went back, so nothing is known.
        let mut header = Header::new(1, 9, 0);
        write(&mut header, &mut tracks, Some((&of, &forecasts)));
        assert_eq!(header, Header::new(1, 9, 0));
    }
}
