//! One simulated device.

use std::sync::Arc;
use std::time::Duration;

use crate::cli::Failure;
use crate::cli::cargo::{Cargo, Epochs, RawBytes};
use crate::cli::connection::Connection;
use crate::cli::device_stream::{Acknowledged, DeviceStream, Next};
use crate::contract::v1;

use super::schedule::{Beginning, Schedule};
use super::traffic::{Content, Traffic};

/// A device with its session.
pub(super) struct Device {
    pub(super) index: usize,
    pub(super) session: String,
    pub(super) connection: Connection,
}

/// What a device has sent, and what the service has answered.
#[derive(Debug, Default)]
pub(super) struct Sent {
    pub(super) session: String,
    /// Whether each epoch is acknowledged; the index is the epoch's number less one.
    pub(super) acknowledged: Vec<bool>,
    /// Answers to epochs that the service had answered before.
    pub(super) repeated: usize,
    /// Delays of the messages (ms).
    pub(super) delays_ms: Vec<f32>,
    /// Refusals of single epochs, and why the device gave up.
    pub(super) errors: Vec<String>,
    /// Streams that ended before the device ended them.
    pub(super) breaks: usize,
}

impl Device {
    /// Opens the stream, and sends all epochs from the common beginning on.
    pub(super) async fn run(
        self,
        traffic: Arc<Traffic>,
        schedule: Schedule,
        beginning: Arc<Beginning>,
    ) -> Sent {
        let mut sent = Sent {
            session: self.session.clone(),
            acknowledged: vec![false; schedule.epochs],
            ..Sent::default()
        };
        let offset = traffic.offset(self.index);
        let due = |epoch| schedule.due(self.index, epoch);
        let done = match &traffic.content {
            Content::Epochs(epochs) => {
                let messages = epochs[offset..].iter().take(schedule.epochs);
                let messages = messages.zip(1..).map(|(epoch, seq)| {
                    let epochs = vec![v1::Epoch { seq, ..epoch.clone() }];
                    (v1::StreamRequest { opening: None, epochs }, seq)
                });
                self.play(Epochs, messages, (due, &beginning), &mut sent).await
            }
            Content::Raw(frames) => {
                let mut offset_bytes = 0;
                let frames = frames[offset..].iter().take(schedule.epochs);
                let messages = frames.map(|frame| {
                    let offset = offset_bytes;
                    offset_bytes += frame.len() as u64;
                    let content = frame.clone();
                    let request =
                        v1::StreamRawRequest { opening: None, offset, content, end: false };
                    (request, offset_bytes)
                });
                self.play(RawBytes { near: None }, messages, (due, &beginning), &mut sent).await
            }
        };
        if let Err(failure) = done {
            sent.errors.push(failure.to_string());
        }
        sent
    }

    async fn play<C: Cargo>(
        &self,
        cargo: C,
        messages: impl Iterator<Item = (C::Request, u64)>,
        (due, beginning): (impl Fn(usize) -> Duration, &Beginning),
        sent: &mut Sent,
    ) -> Result<(), Failure> {
        let answers = v1::Answers::Summary;
        let mut stream = DeviceStream::new((&self.connection, cargo), &self.session, answers, 0);
        let permit = beginning.opening.acquire().await;
        let opened = stream.open().await;
        drop(permit);
        let begin = beginning.at().await; // Also after an error: the other devices wait.
        opened?;
        for (number, (request, through)) in messages.enumerate() {
            let due = begin + due(number);
            while let Next::Acknowledged(acknowledged) = stream.next(Some(due)).await? {
                sent.count(acknowledged);
            }
            stream.send(request, 1, through, due);
        }
        sent.breaks = stream.close(|acknowledged| sent.count(acknowledged)).await?;
        Ok(())
    }
}

impl Sent {
    fn count(&mut self, acknowledged: Acknowledged) {
        let delays = acknowledged.delays.iter().map(|delay| 1e3 * delay.as_secs_f32());
        self.delays_ms.extend(delays);
        for result in acknowledged.results {
            if let Some(refusal) = result.refusal {
                let text = format!("epoch {}: {}: {}", result.seq, refusal.code, refusal.message);
                self.errors.push(text);
                continue;
            }
            let index = (result.seq as usize).wrapping_sub(1);
            match self.acknowledged.get_mut(index) {
                Some(is_acknowledged) => {
                    self.repeated += usize::from(std::mem::replace(is_acknowledged, true));
                }
                None => self.errors.push(format!("epoch {} was never sent", result.seq)),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_given_twice_is_counted() {
        let mut sent = Sent { acknowledged: vec![false; 2], ..Sent::default() };
        let result = |seq| v1::StreamResult { seq, ..Default::default() };
        let results = vec![result(1), result(1), result(3)];
        sent.count(Acknowledged { results, ..Default::default() });
        assert_eq!((sent.acknowledged, sent.repeated), (vec![true, false], 1));
        assert_eq!(sent.errors, ["epoch 3 was never sent"]);
    }
}
