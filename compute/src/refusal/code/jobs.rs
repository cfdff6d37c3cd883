//! Codes of batch jobs.

/// Passes on the codes `before` and its own; see `collected` of the table.
macro_rules! jobs {
    ($then:ident { $($before:tt)* } $($rest:ident)*) => { $then! { { $($before)*

    // Batch jobs.

    /// The service has no folder for the files of jobs.
    JobsOff = "JOBS_OFF", Precondition, "let the operator set jobs.folder";
    /// The job does not exist, or has expired.
    JobNotFound = "JOB_NOT_FOUND", NotFound, "create a job, or check the id";
    /// As many jobs wait, or arrive, as allowed.
    TooManyJobs = "TOO_MANY_JOBS", Exhausted,
        "send the same request later, or let the operator raise jobs.waiting or jobs.uploads";
    /// As many uploads are begun as allowed.
    TooManyUploads = "TOO_MANY_UPLOADS", Exhausted,
        "delete begun uploads (DELETE /v1/uploads/{upload}), wait until one has expired \
         (jobs.upload_hours), or let the operator raise jobs.open_uploads";
    /// A file of a job exceeds its limit, also unpacked, or there are too many.
    JobTooLarge = "JOB_TOO_LARGE", TooLarge,
        "split the recording, or let the operator raise jobs.file_bytes, jobs.unpacked_bytes or \
         jobs.files";
    /// The options of a job, as the part of a body, exceed their limit.
    JobOptionsTooLarge = "JOB_OPTIONS_TOO_LARGE", TooLarge,
        "name fewer files in uploads and urls, and leave out options that are the default";
    /// The files of all jobs need more space than allowed.
    JobSpaceExhausted = "JOB_SPACE_EXHAUSTED", Exhausted,
        "delete jobs that have ended (DELETE /v1/jobs/{job}?purge=true), wait until some have \
         expired (jobs.keep_hours), or let the operator raise jobs.total_bytes";
    /// Another request had the same Idempotency-Key, or requestId.
    IdempotencyConflict = "IDEMPOTENCY_CONFLICT", Conflict,
        "send the request with a key of its own";
    /// The job has not ended.
    JobNotEnded = "JOB_NOT_ENDED", Precondition,
        "ask for the job until it has ended, or cancel it first";
    /// The job has failed or was cancelled.
    JobWithoutResult = "JOB_WITHOUT_RESULT", Precondition,
        "read the state and the failure of the job, and create another one";
    /// A file of a job cannot be read or written.
    JobFilesFailed = "JOB_FILES_FAILED", Unavailable,
        "send the same request again; the operator finds the cause in the log";
    /// The server of the bucket with the files of jobs is away.
    BucketUnavailable = "BUCKET_UNAVAILABLE", Unavailable,
        "send the same request later; the operator checks that jobs.s3.endpoint answers";
    /// The server of the bucket refuses the service.
    BucketRefuses = "BUCKET_REFUSES", Unavailable,
        "let the operator check the credentials, bucket and region of jobs.s3, and that the key \
         may get, put, list and delete objects; the log has the server's answer";
    /// The upload does not exist, or has expired.
    UploadNotFound = "UPLOAD_NOT_FOUND", NotFound, "begin another upload, or check the id";
    /// Another request appends to the upload.
    UploadBusy = "UPLOAD_BUSY", Conflict,
        "end the other request, ask for the offset again, and go on there";
    /// The bytes do not begin where the upload ends.
    UploadOffsetDiffers = "UPLOAD_OFFSET_DIFFERS", Conflict,
        "ask for the offset by HEAD, and go on there";
    /// The bytes go beyond the length with which the upload began.
    UploadTooLong = "UPLOAD_TOO_LONG", TooLarge,
        "send the bytes from the offset on only, or begin an upload of the file's length";
    /// The job names an upload whose bytes are not all there.
    UploadIncomplete = "UPLOAD_INCOMPLETE", Precondition,
        "complete the upload, then create the job";
    /// The request is of another version of the protocol of uploads.
    UploadProtocolUnknown = "UPLOAD_PROTOCOL_UNKNOWN", Changed,
        "use a client of tus 1.0.0, or send the header Tus-Resumable: 1.0.0";
    /// The job has run for longer than allowed.
    JobTooLong = "JOB_TOO_LONG", NoCall,
        "split the recording, choose another mode, or let the operator raise jobs.run_s";
    /// The processes that ran the job have ended or were frozen, several times.
    JobLost = "JOB_LOST", NoCall,
        "split the recording, or let the operator give workers more memory; the log of the \
         workers has the cause";
    /// Workers need a database that several processes write to.
    WorkerNeedsPostgres = "WORKER_NEEDS_POSTGRES", NoCall,
        "move the service to Postgres, or let it run jobs itself with jobs.running";
    /// A worker, or a node of a cluster, does not see the folder of jobs of the others.
    JobFolderDiffers = "JOB_FOLDER_DIFFERS", NoCall,
        "start the service with jobs.folder first, and give every worker and node the same \
         folder, on a shared file system if on another machine";

} $($rest)* } } }
pub(super) use jobs;
