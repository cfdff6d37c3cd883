//! The desk for batch jobs: files of a rover, its base and navigation data in, a file of positions
//! and a report out.
//!
//! A job is computed by `recording`, as `graphfix solve` computes files, and gives the same bytes.
//! A session can stand in place of the rover's file; its epochs are computed by `session`, as in a
//! replay. The queue is in the store; this desk has its files, and a task for each job that may run
//! at the same time. Workers, processes of their own, may run jobs, too.
//!
//! - **Uploads** stream to files that are named after the hash of their content; equal files are
//!   one.
//! - **Uploads of several requests** go on after a break, by the bytes that are stored.
//! - **URLs** in place of files are fetched to such files before their job can run. So is what a
//!   job lacks and the service has: ephemerides and a base.
//! - **A run** is one blocking thread. Before each step it takes a turn of the sessions' solver
//!   pool, in the lane of the lowest share, so that live sessions come first.
//! - **The end** of a job is written with the fence of its claim. A run that was cancelled, or
//!   claimed by another, ends nothing: its result is removed.
//! - **A webhook** is told of the end of its job, with a signature, until its host takes the
//!   message or as many attempts as allowed have failed.
//! - **A bucket** of an S3 service can have the files in place of the folder.
//! - **Nodes of a cluster** share the folder or the bucket. Each takes, runs and answers jobs; the
//!   one that leads fetches, and removes what has expired.
//! - **A process that ends or is frozen** loses its jobs, after some time without heartbeat. The
//!   next run goes on after the last **checkpoint**, with the same bits. A batch, which is answered
//!   as a whole, is computed again from the beginning.

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
mod queue;
mod report;
mod request;
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
