//! The desk for batch jobs: files of a rover, its base and navigation data in, a file of positions
//! and a report out.
//!
//! A job is computed by `recording`, as `graphfix solve` computes files, and gives the same bytes.
//! Instead of the rover's file a job can have a session; its epochs are computed by `session`, as
//! in a replay. The queue is in the store. This desk has the files, and one task for each job that
//! may run at the same time. Workers, which are other processes, may run jobs, too.
//!
//! - **Uploads** are streamed to files that are named after the hash of their content; equal files
//!   are stored once.
//! - **Uploads of several requests** continue after an interruption, from the last stored byte.
//! - **URLs** instead of files are fetched to such files before their job can run. In the same way
//!   the service adds what a job lacks and the service has: ephemerides and a base.
//! - **A run** is one blocking thread. Before each step it takes a turn of the sessions' solver
//!   pool, in the lane with the lowest share, so that live sessions have priority.
//! - **The end** of a job is written with the fence of its claim. A run that was cancelled, or
//!   whose job another process has claimed, writes no end: its result is removed.
//! - **A webhook** is informed of the end of its job by a signed message, until its host accepts
//!   the message or the allowed number of attempts has failed.
//! - **A bucket** of an S3 service can contain the files instead of the folder.
//! - **Nodes of a cluster** share the folder or the bucket. Each takes, runs and answers jobs; the
//!   leader fetches inputs, and removes what has expired.
//! - **A process that ends or is suspended** loses its jobs after some time without heartbeat. The
//!   next run continues after the last **checkpoint**, with the same bits. A batch, which is
//!   answered as a whole, is computed again from the beginning.

mod allowance;
mod arriving;
mod bucket;
mod checkpoints;
mod content;
mod deliveries;
mod desk;
mod error;
mod fetching;
mod files;
mod info;
mod message;
mod named;
mod own;
mod page;
mod permits;
mod queue;
mod report;
mod request;
mod retries;
mod run;
mod shared;
mod sources;
mod state;
mod uploads;
mod watched;
mod webhook;
mod worker;
mod writing;

pub use arriving::{ArrivingFile, Upload};
pub use bucket::BucketError;
pub use content::{PAGE_BYTES, RESULT_CHUNK_BYTES, ResultContent};
pub use deliveries::Deliveries;
pub use desk::{Jobs, Submission, UploadedFile};
pub use error::JobError;
pub use fetching::InputUrl;
pub use files::StoredFile;
pub use info::{JobId, JobInfo, JobResult};
pub use report::{Failure, Report};
pub use request::{
    BaseOrigin, JobInput, JobOptions, JobRequest, Part, SessionInput, SessionSource,
};
pub use uploads::{Appending, UploadId, UploadInfo};
pub use webhook::{Webhook, WebhookSecret};
pub use worker::Worker;
