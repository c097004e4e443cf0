use bytemuck::Zeroable;
use ports::{Answer, Room, Second, Step, Tick};
use wire::{Counts, Header, Rejected, Topic, flags};

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

    /// The frame as the second input of a tick.
    pub fn as_second(&self) -> Second<'_, T> {
        if self.is_void() { Second::Refused } else { Second::Frame(&self.header, &self.elements) }
    }

    pub(crate) fn make_void(&mut self, header: Header) {
        self.header = Header { flags: header.flags | flags::VOID, counts: Counts::default(), ..header };
        self.elements.clear();
    }

    /// Lets a step answer a tick, as the step's process does. `passed` is called when the answer is complete,
    /// before the work for which no later stage waits. It is not called if the input is VOID.
    ///
    /// # Errors
    /// [`Rejected`] if the step refuses the tick. The frame is then VOID. It is also VOID if the input is
    /// VOID, or if the step leaves the tick without an answer.
    pub fn answer<S: Step<Output = T>>(
        &mut self,
        step: &mut S,
        tick: &Tick<'_, S::Input, S::Second>,
        passed: impl FnOnce(),
    ) -> Result<(), Rejected> {
        if tick.header.has(flags::VOID) {
            self.make_void(*tick.header);
            return Ok(());
        }
        let mut memory = Memory::<T> { elements: std::mem::take(&mut self.elements), count: 0 };
        let mut out = Answer::new(*tick.header, &mut memory);
        let result = step.answer(tick, &mut out);
        let (header, is_empty) = (out.header, out.is_empty());
        self.elements = memory.elements;
        self.elements.truncate(memory.count);
        if is_empty || result.is_err() {
            self.make_void(header);
        } else {
            self.header = header;
        }
        passed();
        step.after(tick);
        result
    }
}

/// The memory of a frame. It grows to the size of the largest frame.
struct Memory<T: Topic> {
    elements: Vec<T::Element>,
    count: usize,
}

impl<T: Topic> Room<T> for Memory<T> {
    fn elements(&mut self, count: usize) -> Result<&mut [T::Element], Rejected> {
        self.count = count;
        self.elements.resize(count, T::Element::zeroed());
        Ok(&mut self.elements)
    }
}
