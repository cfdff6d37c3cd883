//! An S3 service that others wrote (`moto`), and a proxy before it that fails on demand.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use graphfix::config::{S3Configuration, S3Keys};

use super::python;
use super::server::free_port;
use super::wait::until;

/// Behaviour of the proxy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Fault {
    /// Forwards everything.
    None,
    /// Closes each connection.
    Away,
    /// Answers this many requests with this status and code.
    Refuses(usize, &'static str, &'static str),
    /// Refuses a request with 503 and then forwards as many as the first number, repeatedly. The
    /// second number is how many are forwarded before the first refusal.
    Flaky(usize, usize),
    /// Cuts this many downloads of objects after this many bytes.
    Cuts(usize, usize),
    /// Lists objects as if they were years old.
    Old,
    /// Stores no object whose name contains this, and does not answer before the behaviour changes.
    Holds(&'static str),
}

/// The service with an empty bucket, behind its proxy. It ends when dropped.
pub(crate) struct Buckets {
    server: Child,
    python: String,
    port: u16,
    proxy: u16,
    fault: Arc<Mutex<Fault>>,
    /// Method and address of each request.
    requests: Arc<Mutex<Vec<String>>>,
}

impl Drop for Buckets {
    fn drop(&mut self) {
        // Err: it has ended.
        self.server.kill().ok();
        self.server.wait().ok();
    }
}

impl Buckets {
    /// Starts the service; `None` (noted) if its programs are absent.
    pub(crate) async fn start() -> Option<Self> {
        let (python, port) = (python::with("boto3, moto.server")?, free_port());
        let mut command = Command::new(&python);
        command.args(["-m", "moto.server", "-p", &port.to_string()]);
        let silent = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        let server = silent.spawn().unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let proxy = listener.local_addr().unwrap().port();
        let fault = Arc::new(Mutex::new(Fault::None));
        let requests = Arc::<Mutex<Vec<String>>>::default();
        let shared = (fault.clone(), requests.clone());
        thread::spawn(move || {
            for client in listener.incoming().flatten() {
                let (fault, requests) = shared.clone();
                // Err: either end has closed its connection.
                thread::spawn(move || forward(client, port, &fault, &requests).ok());
            }
        });
        let buckets = Self { server, python, port, proxy, fault, requests };
        let connects = async || TcpStream::connect(("127.0.0.1", port)).is_ok();
        until("an S3 service", connects, |is_there| *is_there).await;
        buckets.ask(&["create"]);
        Some(buckets)
    }

    /// Sets the behaviour of the proxy.
    pub(crate) fn set(&self, fault: Fault) {
        *self.fault.lock().unwrap() = fault;
    }

    /// The present behaviour of the proxy.
    pub(crate) fn fault(&self) -> Fault {
        *self.fault.lock().unwrap()
    }

    /// Number of requests that came through the proxy, and number of those whose signature is the
    /// one of Amazon's own code with this secret.
    pub(crate) fn signed_with(&self, secret: &str) -> (usize, usize) {
        let script = python_script("signatures.py");
        let mut command = Command::new(&self.python);
        let piped = command.arg(script).arg(secret).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut checking = piped.spawn().unwrap();
        let requests = self.requests.lock().unwrap().clone();
        checking.stdin.take().unwrap().write_all(requests.join("\n").as_bytes()).unwrap();
        let output = checking.wait_with_output().unwrap();
        assert!(output.status.success(), "the addresses were not understood");
        let right = String::from_utf8(output.stdout).unwrap().trim().parse().unwrap();
        (requests.len(), right)
    }

    /// Runs Amazon's client with these arguments. Returns its output.
    pub(crate) fn ask(&self, arguments: &[&str]) -> Vec<u8> {
        let script = python_script("bucket.py");
        let endpoint = format!("http://127.0.0.1:{}", self.port);
        let mut command = Command::new(&self.python);
        let output = command.arg(script).arg(endpoint).args(arguments).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        output.stdout
    }

    /// The names of the objects that begin with `begin`, without this prefix.
    pub(crate) fn names(&self, begin: &str) -> Vec<String> {
        let keys = String::from_utf8(self.ask(&["keys"])).unwrap();
        keys.lines().filter_map(|key| key.strip_prefix(begin)).map(str::to_owned).collect()
    }

    /// The bucket in a configuration.
    pub(crate) fn configuration(&self) -> S3Configuration {
        S3Configuration {
            endpoint: format!("http://127.0.0.1:{}", self.proxy),
            region: "us-east-1".to_owned(),
            bucket: "jobs".to_owned(),
            prefix: "of/us".to_owned(),
            path_style: true,
            credentials_file: None,
            ca_file: None,
            keys: Some(S3Keys { id: "an-id".into(), secret: "a-secret".into(), token: None }),
        }
    }

    /// The same in a file, without the credentials.
    pub(crate) fn toml(&self, prefix: &str) -> String {
        let proxy = self.proxy;
        format!(
            "[jobs.s3]\nendpoint = \"http://127.0.0.1:{proxy}\"\nbucket = \"jobs\"\n\
             prefix = \"{prefix}\"\n"
        )
    }
}

fn python_script(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/python").join(name)
}

/// Method and address of a request.
fn address(head: &str) -> String {
    let mut words = head.split_ascii_whitespace();
    let (method, path) = (words.next().unwrap(), words.next().unwrap());
    let mut lines = head.lines().map(|line| line.split_once(": ").unwrap_or((line, "")));
    let (_, host) = lines.find(|(name, _)| name.eq_ignore_ascii_case("host")).unwrap();
    format!("{method} http://{host}{path}")
}

/// Accepts one request, records it, and answers it according to the fault.
fn forward(
    mut client: TcpStream,
    port: u16,
    fault: &Mutex<Fault>,
    requests: &Mutex<Vec<String>>,
) -> std::io::Result<()> {
    let (mut request, mut byte) = (Vec::new(), [0]);
    while !request.ends_with(b"\r\n\r\n") {
        client.read_exact(&mut byte)?;
        request.push(byte[0]);
    }
    let head = String::from_utf8_lossy(&request);
    requests.lock().unwrap().push(address(&head));
    let head = head.to_ascii_lowercase();
    let length = head.split("content-length: ").nth(1).and_then(|rest| rest.lines().next());
    let mut content = vec![0; length.map_or(0, |length| length.parse().unwrap())];
    client.read_exact(&mut content)?;
    let is_list = head.contains("list-type=2");
    let is_download = head.starts_with("get ") && !is_list && !head.contains("folder.id");
    let now = {
        let mut fault = fault.lock().unwrap();
        let now = *fault;
        *fault = match now {
            Fault::Refuses(1, ..) => Fault::None,
            Fault::Refuses(count, status, code) => Fault::Refuses(count - 1, status, code),
            Fault::Flaky(others, 0) => Fault::Flaky(others, others),
            Fault::Flaky(others, left) => Fault::Flaky(others, left - 1),
            Fault::Cuts(1, _) if is_download => Fault::None,
            Fault::Cuts(count, after) if is_download => Fault::Cuts(count - 1, after),
            same => same,
        };
        now
    };
    match now {
        Fault::Away => return Ok(()),
        Fault::Refuses(_, status, code) => return refuse(&mut client, status, code),
        Fault::Flaky(_, 0) => return refuse(&mut client, "503 Slow Down", "SlowDown"),
        Fault::Holds(part) if head.lines().next().is_some_and(|line| is_upload_of(line, part)) => {
            while *fault.lock().unwrap() == now {
                thread::sleep(Duration::from_millis(10));
            }
            return Ok(());
        }
        _ => {}
    }
    let mut server = TcpStream::connect(("127.0.0.1", port))?;
    server.write_all(&request)?;
    server.write_all(&content)?;
    let mut answer = Vec::new();
    server.read_to_end(&mut answer)?;
    match now {
        Fault::Cuts(_, after) if is_download => {
            let body = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n").unwrap() + 4;
            answer.truncate(body + after);
        }
        Fault::Old if is_list => {
            let text = String::from_utf8(answer).unwrap();
            let (year, old) = ("<LastModified>20", "<LastModified>19");
            answer = text.replace(year, old).into_bytes();
        }
        _ => {}
    }
    client.write_all(&answer)
}

/// Whether the first line of a request uploads an object whose name contains `part`.
fn is_upload_of(line: &str, part: &str) -> bool {
    line.starts_with("put ") && line.contains(part)
}

fn refuse(client: &mut TcpStream, status: &str, code: &str) -> std::io::Result<()> {
    let body = format!("<Error><Code>{code}</Code><Message>As asked.</Message></Error>");
    let length = body.len();
    let head = format!("HTTP/1.1 {status}\r\nContent-Length: {length}\r\n\r\n");
    client.write_all(format!("{head}{body}").as_bytes())
}
