//! Balancers before the nodes of a cluster, which hash the header of the session.

use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use tempfile::TempDir;

use super::data;
use super::server::free_port;

/// A balancer, killed when dropped.
pub(crate) struct Balancer {
    child: Child,
    pub(crate) port: u16,
    _folder: TempDir,
}

impl Balancer {
    /// HAProxy before the nodes of these ports; `None` (noted) if it is not installed.
    pub(crate) fn haproxy(ports: &[u16]) -> Option<Self> {
        let port = free_port();
        let mut text = format!(
            "global\n  maxconn 2000\ndefaults\n  mode http\n  timeout connect 1s\n  \
             timeout client 60s\n  timeout server 60s\n  timeout check 1s\n  option redispatch\n  \
             retries 2\nfrontend devices\n  bind 127.0.0.1:{port} proto h2\n  \
             default_backend nodes\nbackend nodes\n  balance hdr(x-graphfix-session)\n  \
             hash-type consistent\n  option httpchk\n  \
             http-check send meth GET uri /readyz ver HTTP/1.1 hdr Host localhost\n  \
             http-check expect status 200\n  default-server proto h2 check check-proto h1 \
             inter 1s fall 2 rise 2 on-marked-down shutdown-sessions\n"
        );
        for (index, port) in ports.iter().enumerate() {
            writeln!(text, "  server node{index} 127.0.0.1:{port}").unwrap();
        }
        Self::start("haproxy", &text, port, |command, file| {
            command.arg("-f").arg(file).arg("-db");
        })
    }

    /// The same with nginx.
    pub(crate) fn nginx(ports: &[u16]) -> Option<Self> {
        let port = free_port();
        let mut servers = String::new();
        for port in ports {
            write!(servers, "server 127.0.0.1:{port} max_fails=1 fail_timeout=2s; ").unwrap();
        }
        let text = format!(
            "daemon off; error_log stderr crit; pid nginx.pid;\n\
             events {{ worker_connections 1024; }}\n\
             http {{ access_log off; client_body_temp_path body; proxy_temp_path proxy;\n\
             fastcgi_temp_path fastcgi; uwsgi_temp_path uwsgi; scgi_temp_path scgi;\n\
             upstream nodes {{ hash $http_x_graphfix_session consistent; {servers} }}\n\
             server {{ listen 127.0.0.1:{port} http2;\n\
             location / {{ grpc_pass grpc://nodes; grpc_set_header Host localhost;\n\
             grpc_connect_timeout 1s; grpc_read_timeout 60s; client_max_body_size 0;\n\
             client_body_timeout 1h; grpc_send_timeout 1h; }} }} }}\n"
        );
        Self::start("nginx", &text, port, |command, file| {
            command.arg("-p").arg(file.parent().unwrap()).arg("-c").arg(file);
        })
    }

    #[track_caller]
    fn start(
        program: &str,
        configuration: &str,
        port: u16,
        change: impl FnOnce(&mut Command, &Path),
    ) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("balancer.conf");
        fs::write(&file, configuration).unwrap();
        let path = Path::new("/usr/sbin").join(program);
        if !path.exists() {
            data::note_missing(program);
            return None;
        }
        let mut command = Command::new(path);
        command.stdin(Stdio::null());
        change(&mut command, &file);
        Some(Self { child: command.spawn().unwrap(), port, _folder: folder })
    }
}

impl Drop for Balancer {
    fn drop(&mut self) {
        // Err: it has ended.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
