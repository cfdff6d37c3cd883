//! An S3 service that others wrote (`moto`), and a proxy before it that fails on demand.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread;

use graphfix::config::{S3Configuration, S3Keys};

use super::python;
use super::server::free_port;
use super::wait::until;

/// What the proxy does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Fault {
    /// Forwards everything.
    None,
    /// Closes each connection.
    Away,
    /// Gives this many requests this status and code.
    Refuses(usize, &'static str, &'static str),
    /// Gives the request after so many others 503, and goes on so.
    Flaky(usize, usize),
    /// Cuts this many downloads of objects after this many bytes.
    Cuts(usize, usize),
    /// Lists objects as if they were years old.
    Old,
}

/// The service with an empty bucket, behind its proxy. It ends when dropped.
pub(crate) struct Buckets {
    server: Child,
    python: String,
    port: u16,
    proxy: u16,
    fault: Arc<Mutex<Fault>>,
}

impl Drop for Buckets {
    fn drop(&mut self) {
        // Err: it has ended.
        self.server.kill().ok();
        self.server.wait().ok();
    }
}

impl Buckets {
    /// Starts it; `None` (noted) without the programs.
    pub(crate) async fn start() -> Option<Self> {
        let (python, port) = (python::with("boto3, moto.server")?, free_port());
        let mut command = Command::new(&python);
        command.args(["-m", "moto.server", "-p", &port.to_string()]);
        let silent = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        let server = silent.spawn().unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let proxy = listener.local_addr().unwrap().port();
        let fault = Arc::new(Mutex::new(Fault::None));
        let shared = fault.clone();
        thread::spawn(move || {
            for client in listener.incoming().flatten() {
                let fault = shared.clone();
                // Err: either end has closed its connection.
                thread::spawn(move || forward(client, port, &fault).ok());
            }
        });
        let buckets = Self { server, python, port, proxy, fault };
        let connects = async || TcpStream::connect(("127.0.0.1", port)).is_ok();
        until("an S3 service", connects, |is_there| *is_there).await;
        buckets.ask(&["create"]);
        Some(buckets)
    }

    /// From now on the proxy does this.
    pub(crate) fn set(&self, fault: Fault) {
        *self.fault.lock().unwrap() = fault;
    }

    /// What the proxy does now.
    pub(crate) fn fault(&self) -> Fault {
        *self.fault.lock().unwrap()
    }

    /// Lets Amazon's client do something.
    pub(crate) fn ask(&self, arguments: &[&str]) -> Vec<u8> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/python/bucket.py");
        let endpoint = format!("http://127.0.0.1:{}", self.port);
        let mut command = Command::new(&self.python);
        let output = command.arg(script).arg(endpoint).args(arguments).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        output.stdout
    }

    /// The names of the objects that begin so, without this beginning.
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

/// Takes one request, and answers it as the fault says.
fn forward(mut client: TcpStream, port: u16, fault: &Mutex<Fault>) -> std::io::Result<()> {
    let (mut request, mut byte) = (Vec::new(), [0]);
    while !request.ends_with(b"\r\n\r\n") {
        client.read_exact(&mut byte)?;
        request.push(byte[0]);
    }
    let head = String::from_utf8_lossy(&request).to_ascii_lowercase();
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

fn refuse(client: &mut TcpStream, status: &str, code: &str) -> std::io::Result<()> {
    let body = format!("<Error><Code>{code}</Code><Message>As asked.</Message></Error>");
    let length = body.len();
    let head = format!("HTTP/1.1 {status}\r\nContent-Length: {length}\r\n\r\n");
    client.write_all(format!("{head}{body}").as_bytes())
}
