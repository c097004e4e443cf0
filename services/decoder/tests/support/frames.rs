//! Encodings of agents of all types.

use bytemuck::Zeroable;
use decoder::Decoder;
use ports::Allowance;
use testing::value;
use wire::{AgentControls, AgentEncoding, Header, Rejected};

/// Encodings of agents with full histories. Every fifth agent is not forecastable.
pub fn encodings(agents_len: usize) -> Vec<AgentEncoding> {
    let encoding = |i: usize| {
        let mut agent = AgentEncoding {
            id: 100 + i as u64,
            agent_type: (i % 3) as u32,
            forecastable: u32::from(i % 5 != 4),
            present: 0xff,
            ..AgentEncoding::zeroed()
        };
        agent.state.as_flattened_mut().iter_mut().enumerate().for_each(|(k, x)| *x = value(i * 48 + k));
        agent.temporal.iter_mut().enumerate().for_each(|(k, x)| *x = value(i * 64 + k + 7));
        agent
    };
    (0..agents_len).map(encoding).collect()
}

/// The header of a tick.
pub fn header(seq: u64) -> Header {
    Header::new(1, seq, seq as i64 * 80_000_000)
}

/// Zeroed controls, one for each agent to be forecast.
pub fn room(encodings: &[AgentEncoding]) -> Vec<AgentControls> {
    vec![AgentControls::zeroed(); Decoder::len(encodings)]
}

/// Decodes all agents of a frame.
pub fn decode(
    decoder: &mut Decoder,
    header: &Header,
    encodings: &[AgentEncoding],
    out: &mut [AgentControls],
) -> Result<(), Rejected> {
    decoder.serve(header, encodings, Allowance::All)?;
    decoder.write(out);
    Ok(())
}
