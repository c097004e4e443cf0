use std::sync::Arc;

use ports::Readable;
use wire::{Header, Topic, flags};

/// A frame in owned memory.
#[derive(Clone, Debug)]
pub struct OwnFrame<T: Topic> {
    /// The header. It contains only the hops of the input frame.
    pub header: Header,
    /// Elements.
    pub elements: Vec<T::Element>,
}

impl<T: Topic> Default for OwnFrame<T> {
    /// An empty VOID frame.
    fn default() -> Self {
        Self { header: Header { flags: flags::VOID, ..Header::default() }, elements: Vec::new() }
    }
}

impl<T: Topic> OwnFrame<T> {
    /// Whether a stage has refused the tick.
    pub const fn is_void(&self) -> bool {
        self.header.has(flags::VOID)
    }

    /// Header and elements.
    pub fn parts(&self) -> (&Header, &[T::Element]) {
        (&self.header, &self.elements)
    }
}

impl<T: Topic> Readable<T> for OwnFrame<T> {
    fn header(&self) -> &Header {
        &self.header
    }

    fn elements(&self) -> &[T::Element] {
        &self.elements
    }
}

/// The newest frame of a topic, and frames whose memory can be used again.
pub(crate) struct Slot<T: Topic> {
    frame: Arc<OwnFrame<T>>,
    /// Whether the frame belongs to the tick.
    is_present: bool,
    pool: Vec<Arc<OwnFrame<T>>>,
}

impl<T: Topic> Default for Slot<T> {
    fn default() -> Self {
        Self { frame: Arc::default(), is_present: false, pool: Vec::new() }
    }
}

impl<T: Topic> Slot<T> {
    pub fn frame(&self) -> &OwnFrame<T> {
        &self.frame
    }

    /// The frame, if it belongs to the tick.
    pub fn present(&self) -> Option<&Arc<OwnFrame<T>>> {
        self.is_present.then_some(&self.frame)
    }

    /// Lets `write` fill a frame that nobody reads, and makes it the newest.
    pub fn write(&mut self, write: impl FnOnce(&mut OwnFrame<T>)) {
        let mut pool = self.pool.iter_mut();
        let free = pool.position(|frame| Arc::get_mut(frame).is_some());
        let mut frame = free.map_or_else(Arc::default, |free| self.pool.swap_remove(free));
        if let Some(frame) = Arc::get_mut(&mut frame) {
            write(frame);
        }
        self.pool.push(std::mem::replace(&mut self.frame, frame));
        self.is_present = true;
    }

    pub fn put(&mut self, frame: Arc<OwnFrame<T>>) {
        self.frame = frame;
        self.is_present = true;
    }

    pub const fn clear(&mut self) {
        self.is_present = false;
    }
}
