//! The unanswered pushes of a stream, counted against its credit and the memory of all requests.

use std::collections::VecDeque;

use crate::contract::{Lease, Refusal};
use crate::refusal::Code;

/// A number of epochs or chunks, and bytes of messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Amount {
    pub(super) count: u64,
    pub(super) bytes: u64,
}

impl Amount {
    fn add(&mut self, other: Self) {
        self.count += other.count;
        self.bytes += other.bytes;
    }
}

/// A push that is not answered yet.
struct OnItsWay {
    amount: Amount,
    memory: usize,
}

/// The account of one stream.
pub(super) struct Ledger {
    window: Amount,
    received: Amount,
    answered: Amount,
    on_its_way: VecDeque<OnItsWay>,
    memory: usize,
    /// Memory of a page of stored answers that is being sent (bytes).
    page: usize,
    lease: Option<Lease>,
}

impl Ledger {
    /// The account of a stream on which at most `window` may be unanswered.
    pub(super) fn new(window: Amount, lease: Option<Lease>) -> Self {
        let (received, answered) = Default::default();
        let (memory, page) = (0, 0);
        Self { window, received, answered, on_its_way: VecDeque::new(), memory, page, lease }
    }

    /// Length of the message that was just decoded, if the door has counted it.
    pub(super) fn last_message(&self) -> Option<usize> {
        self.lease.as_ref().map(Lease::last_message)
    }

    /// Counts a message with its epochs or chunk.
    ///
    /// # Errors
    /// [`Code::CreditExceeded`].
    pub(super) fn receive(&mut self, amount: Amount) -> Result<(), Refusal> {
        self.received.add(amount);
        let (received, credit) = (self.received, self.credit());
        let exceeded = |what: &str, sent: u64, credit: u64, field: &str| {
            let message = format!("{sent} {what} were sent, and the credit is {credit}");
            Err(Refusal::new(Code::CreditExceeded, message).at(field))
        };
        if credit.count < received.count {
            return exceeded("epochs or chunks", received.count, credit.count, "credit.epochs");
        }
        if credit.bytes < received.bytes {
            return exceeded("bytes", received.bytes, credit.bytes, "credit.bytes");
        }
        Ok(())
    }

    /// Keeps the memory of a push until it is answered.
    ///
    /// # Errors
    /// The memory of all requests is exhausted.
    pub(super) fn keep(&mut self, amount: Amount, memory: usize) -> Result<(), Refusal> {
        self.memory += memory;
        self.on_its_way.push_back(OnItsWay { amount, memory });
        self.settle()
    }

    /// Counts a message without content as answered.
    pub(super) fn answer_empty(&mut self, amount: Amount) -> Result<(), Refusal> {
        self.answered.add(amount);
        self.settle()
    }

    /// Counts the oldest push as answered.
    pub(super) fn answer(&mut self) -> Result<(), Refusal> {
        if let Some(OnItsWay { amount, memory }) = self.on_its_way.pop_front() {
            self.answered.add(amount);
            self.memory -= memory;
        }
        self.settle()
    }

    /// Removes the newest push, which was not posted.
    pub(super) fn forget_newest(&mut self) {
        if let Some(OnItsWay { memory, .. }) = self.on_its_way.pop_back() {
            self.memory -= memory;
        }
    }

    /// Removes all pushes that will not be answered.
    pub(super) fn clear(&mut self) {
        self.on_its_way.clear();
        self.memory = 0;
    }

    /// Keeps the memory of a page of stored answers, and frees that of the previous page.
    ///
    /// # Errors
    /// The memory of all requests is exhausted.
    pub(super) fn keep_page(&mut self, bytes: usize) -> Result<(), Refusal> {
        let before = std::mem::replace(&mut self.page, bytes);
        if before == bytes { Ok(()) } else { self.settle() }
    }

    /// Whether everything is answered.
    pub(super) fn is_settled(&self) -> bool {
        self.on_its_way.is_empty()
    }

    /// Whether another message may be read. While memory is short, a stream waits for its answers.
    /// Otherwise it could exhaust the memory, which would end the stream.
    pub(super) fn has_room(&self) -> bool {
        self.on_its_way.is_empty() || !self.lease.as_ref().is_some_and(Lease::is_short)
    }

    /// The total that the stream may have received.
    pub(super) fn credit(&self) -> Amount {
        let mut credit = self.answered;
        credit.add(self.window);
        credit
    }

    fn settle(&self) -> Result<(), Refusal> {
        self.lease.as_ref().map_or(Ok(()), |lease| lease.settle(self.memory + self.page))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn credit_rises_with_the_answers() {
        let mut ledger = Ledger::new(Amount { count: 2, bytes: 100 }, None);
        let message = Amount { count: 1, bytes: 40 };
        for _ in 0..2 {
            ledger.receive(message).unwrap();
            ledger.keep(message, 7).unwrap();
        }
        ledger.answer().unwrap();
        assert_eq!(ledger.credit(), Amount { count: 3, bytes: 140 });
        ledger.receive(message).unwrap();
        let refusal = ledger.receive(message).unwrap_err();
        assert_eq!(refusal.code, Code::CreditExceeded);
        assert_eq!(refusal.field.as_deref(), Some("credit.epochs"));
    }

    #[test]
    fn empty_messages_use_bytes_until_they_are_answered() {
        let mut ledger = Ledger::new(Amount { count: 2, bytes: 100 }, None);
        let empty = Amount { count: 0, bytes: 60 };
        ledger.receive(empty).unwrap();
        let refusal = ledger.receive(empty).unwrap_err();
        assert_eq!(refusal.field.as_deref(), Some("credit.bytes"));
        ledger.answer_empty(empty).unwrap();
        ledger.answer_empty(empty).unwrap();
        ledger.receive(Amount { count: 2, bytes: 100 }).unwrap();
        assert!(ledger.is_settled());
    }
}
