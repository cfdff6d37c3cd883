//! `GET /docs/errors`: every code with its cause and remedy. The `type` of a problem document
//! points to this page.

use std::fmt::Write;

use axum::http::{HeaderName, header};

use crate::grpc::grpc_code;
use crate::refusal::{Class, Code};

use super::problem::http_status;

/// `Content-Security-Policy` of the page, which loads no other file.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'";
const HEAD: &str = "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\">\
    <title>Graphfix: errors</title><style>body{font:16px/1.5 sans-serif;max-width:50rem;\
    margin:2rem auto;padding:0 1rem}:target{background:#ffd}</style><h1>Errors</h1>\
    <p>The codes of refusals and failures; an answer names one in <code>code</code>.</p>";

/// The page of all codes.
pub(super) async fn errors() -> ([(HeaderName, &'static str); 2], String) {
    let kind = (header::CONTENT_TYPE, "text/html; charset=utf-8");
    ([kind, (header::CONTENT_SECURITY_POLICY, POLICY)], page())
}

fn page() -> String {
    let mut page = HEAD.to_owned();
    for code in Code::ALL {
        let (cause, remedy, class) = (escaped(code.cause()), escaped(code.remedy()), code.class());
        write!(page, "<h2 id=\"{code}\">{code}</h2><p>{cause}</p><p>Remedy: {remedy}.</p>")
            .expect("a text takes any text");
        if class != Class::NoCall {
            let (http, grpc, retry) =
                (http_status(class).as_u16(), grpc_code(class), class.retry());
            write!(
                page,
                "<p>HTTP {http}, gRPC {grpc:?}. Send the same request again: {retry}.</p>"
            )
            .expect("a text takes any text");
        }
    }
    page
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
