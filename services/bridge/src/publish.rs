//! Sends the forecasts of a run to other boxes: as a stage of pipeline.toml, or as a tool that follows a run
//! through its tap. No tick waits for it.

use std::path::Path;
use std::time::{Duration, Instant};

use ports::{Stage, StageError, Stop};
use recording::About;
use recording::tap::{Client, Item, Request};
use run::{Declaration, Run};
use thiserror::Error;
use wire::{Forecast, ForecastsTopic, Header, Topic as _, WorldOrigin, flags};

use crate::frame::{Kind, TickHead, forecasts};
use crate::options::{LinkOptionError, Options, Protection};
use crate::report::Report;
use crate::sender::Sender;
use crate::socket::Address;

/// The stage, which pipeline.toml adds.
pub const STAGE: Declaration<Options> =
    Declaration::added(&[ForecastsTopic::NAME], &[]).with_rule(Options::check_output);

/// Longest wait for a frame of the tap.
const WAIT: Duration = Duration::from_millis(100);

/// Why forecasts can't be sent.
#[derive(Debug, Error)]
pub enum SendError {
    /// The link can't be used.
    #[error(transparent)]
    Link(#[from] LinkOptionError),
    /// The address can't be used.
    #[error("{0}: {1}")]
    Listen(Address, std::io::Error),
    /// The run can't be read.
    #[error("{0}")]
    Run(String),
}

impl From<SendError> for StageError {
    fn from(error: SendError) -> Self {
        match error {
            SendError::Link(_) => Self::config(error),
            // An interface may come up later: the stage is started again.
            SendError::Listen(..) | SendError::Run(_) => Self::data(error),
        }
    }
}

/// Sends the forecasts of the run that this process is a stage of.
///
/// # Errors
/// [`StageError`] if an option, the address or the run's shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    let options = STAGE.options(run)?;
    // The rule of the options has refused its absence.
    let Some(address) = options.listen.clone() else { return Ok(()) };
    let mut stage = Stage::open(run, &STAGE)?;
    let frames = stage.subscribe_deep::<ForecastsTopic>(ForecastsTopic::DEPTH_MAX)?;
    let mut publisher = Publisher::open(&address, &options.protection(), options.modes, run.origin())?;
    while let Some(frame) = stage.take(&frames)? {
        let header = *frame.header();
        publisher.send(&header, &frame);
        drop(frame);
        stage.set_link(publisher.sender.counts().list(0));
        if header.has(flags::END) {
            stage.beat()?;
            break;
        }
        if header.is_tick() {
            stage.done(header.seq);
        }
    }
    tracing::info!("{}", publisher.sender.counts());
    Ok(())
}

/// Sends the forecasts of a run, by its folder, until it ends or `stop` is requested.
///
/// # Errors
/// [`SendError`] if the address or the run can't be used.
pub fn follow(
    root: &Path,
    address: &Address,
    protection: &Protection,
    modes: usize,
    stop: &Stop,
) -> Result<(), SendError> {
    let failed = |error: &dyn std::fmt::Display| SendError::Run(error.to_string());
    let about = About::of_run(root).map_err(|error| failed(&error))?;
    let topics = vec![ForecastsTopic::NAME.to_owned()];
    let request = Request { tool: "bridge".to_owned(), topics, events: false, mark: None, recording: None };
    let mut tap = Client::attach(root, &request).map_err(|error| failed(&error))?;
    let mut publisher = Publisher::open(address, protection, modes, about.run.origin())?;
    while !stop.requested() && !tap.is_closed() {
        match tap.next(WAIT).map_err(|error| failed(&error))? {
            Some(Item::Frame(frame)) => {
                if let Ok(forecasts) = frame.elements::<ForecastsTopic>() {
                    publisher.send(frame.header(), &forecasts);
                }
            }
            Some(Item::Refused(why)) => return Err(SendError::Run(why)),
            Some(_) | None => {}
        }
    }
    tracing::info!("{}", publisher.sender.counts());
    Ok(())
}

/// Sends the forecasts of a run.
struct Publisher {
    sender: Sender,
    modes: usize,
    origin: WorldOrigin,
    report: Report,
}

impl Publisher {
    fn open(
        address: &Address,
        protection: &Protection,
        modes: usize,
        origin: WorldOrigin,
    ) -> Result<Self, SendError> {
        let key = protection.key(address)?;
        let sender = Sender::listen(address, Kind::Forecasts, key, protection.timeout())
            .map_err(|error| SendError::Listen(address.clone(), error))?;
        tracing::info!("forecasts on {}", sender.address());
        Ok(Self { sender, modes, origin, report: Report::new(Instant::now()) })
    }

    /// Sends a tick. A refused tick is not sent: a receiver would take it for an empty road.
    fn send(&mut self, header: &Header, elements: &[Forecast]) {
        if header.is_tick() && !header.has(flags::VOID) {
            let head = TickHead::of(header, self.origin);
            self.sender.send(header.released_ns, |body| forecasts::write(body, &head, elements, self.modes));
        }
        self.report.log(self.sender.counts(), String::new);
    }
}
