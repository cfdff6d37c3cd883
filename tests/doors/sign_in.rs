//! Sign-in of browsers: a key is exchanged for a cookie, which has the rights of the key.

use axum::body::Body;
use axum::http::{HeaderMap, Request, StatusCode};
use serde_json::{Value, json};
use tower::ServiceExt;

use crate::support::doors::{Doors, code};

/// Status, headers and JSON of an answer.
async fn answered(
    doors: &Doors,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
) -> (StatusCode, HeaderMap, Value) {
    let mut request = Request::builder().method(method).uri(path);
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let response = doors.router.clone().oneshot(request.body(Body::empty()).unwrap()).await;
    let (head, body) = response.unwrap().into_parts();
    let bytes = axum::body::to_bytes(body, usize::MAX).await.unwrap();
    (head.status, head.headers, serde_json::from_slice(&bytes).unwrap_or(Value::Null))
}

/// A new key with these rights, made with `by` if there are keys.
async fn key(doors: &Doors, by: &str, rights: Value) -> (String, String) {
    let request = Request::post("/v1/keys").header("content-type", "application/json");
    let request = request.header("authorization", format!("Bearer {by}"));
    let body = Body::from(json!({"rights": rights}).to_string());
    let (status, answer) = doors.ask(request.body(body).unwrap()).await;
    assert_eq!(status, StatusCode::CREATED, "{answer}");
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    (text(&answer["key"]["key"]), text(&answer["secret"]))
}

/// The cookie that an answer sets, as a browser sends it back.
fn cookie_of(headers: &HeaderMap) -> String {
    let text = headers["set-cookie"].to_str().unwrap();
    for part in ["Path=/", "HttpOnly", "SameSite=Strict"] {
        assert!(text.split("; ").any(|found| found == part), "{text}");
    }
    text.split(';').next().unwrap().to_owned()
}

#[tokio::test]
async fn a_browser_signs_in_and_out() {
    let doors = Doors::open().await;
    let (_, _, state) = answered(&doors, "GET", "/v1/sign-in", &[]).await;
    assert_eq!(state, json!({"needed": false, "rights": []}));
    let (_, admin) = key(&doors, "", json!(["admin"])).await;
    let (id, secret) = key(&doors, &admin, json!(["read", "operate"])).await;
    let (_, _, state) = answered(&doors, "GET", "/v1/sign-in", &[]).await;
    assert_eq!(state, json!({"needed": true, "rights": []}));
    let (status, _, refused) = answered(&doors, "POST", "/v1/sign-in", &[]).await;
    assert_eq!((status.as_u16(), code(&refused)), (401, "KEY_REQUIRED"));

    let bearer = format!("Bearer {secret}");
    let (status, headers, begun) =
        answered(&doors, "POST", "/v1/sign-in", &[("authorization", &bearer)]).await;
    assert_eq!(status, StatusCode::CREATED, "{begun}");
    assert_eq!(headers["cache-control"], "no-store");
    assert_eq!(begun["key"], json!(id));
    let cookie = cookie_of(&headers);
    assert!(!cookie.contains(&secret), "the cookie is not the key");
    let signed = ("cookie", &*cookie);
    let place = headers["location"].to_str().unwrap();
    let (_, _, state) = answered(&doors, "GET", place, &[signed]).await;
    assert_eq!(state, begun);
    let (status, _, _) = answered(&doors, "GET", "/v1/sessions", &[signed]).await;
    assert_eq!(status, StatusCode::OK);
    let (status, _, refused) = answered(&doors, "GET", "/v1/keys", &[signed]).await;
    assert_eq!((status.as_u16(), code(&refused)), (403, "RIGHT_MISSING"));

    let token = begun["csrfToken"].as_str().unwrap();
    for wrong in [vec![signed], vec![signed, ("x-graphfix-csrf", "gfx_0")]] {
        for (method, path) in [("DELETE", "/v1/sign-in"), ("DELETE", "/v1/sessions/ses_0")] {
            let (status, _, refused) = answered(&doors, method, path, &wrong).await;
            assert_eq!((status.as_u16(), code(&refused)), (403, "CSRF_TOKEN_INVALID"), "{path}");
        }
    }
    let with_token = [signed, ("x-graphfix-csrf", token)];
    // A stolen cookie must not outlive its sign-in.
    let (status, headers, refused) = answered(&doors, "POST", "/v1/sign-in", &with_token).await;
    assert_eq!((status.as_u16(), code(&refused)), (401, "KEY_REQUIRED"));
    assert!(!headers.contains_key("set-cookie"));
    let (status, _, missing) = answered(&doors, "DELETE", "/v1/sessions/ses_0", &with_token).await;
    assert_eq!((status.as_u16(), code(&missing)), (404, "SESSION_NOT_FOUND"));
    let (status, headers, ended) = answered(&doors, "DELETE", "/v1/sign-in", &with_token).await;
    assert_eq!((status, &ended["key"]), (StatusCode::OK, &Value::Null));
    assert!(headers["set-cookie"].to_str().unwrap().contains("Max-Age=0"));
    let (status, _, refused) = answered(&doors, "GET", "/v1/sessions", &[signed]).await;
    assert_eq!((status.as_u16(), code(&refused)), (401, "SIGN_IN_ENDED"));
}

/// A sign-in has the rights of its key and ends with the key. A proxy with TLS gets a secure
/// cookie.
#[tokio::test]
async fn a_sign_in_ends_with_its_key() {
    let doors = Doors::open().await;
    let (_, admin) = key(&doors, "", json!(["admin"])).await;
    let (id, secret) = key(&doors, &admin, json!(["read"])).await;
    let bearer = format!("Bearer {secret}");
    let headers = [("authorization", &*bearer), ("x-forwarded-proto", "https")];
    let (_, headers, _) = answered(&doors, "POST", "/v1/sign-in", &headers).await;
    assert!(headers["set-cookie"].to_str().unwrap().ends_with("; Secure"));
    let cookie = cookie_of(&headers);
    let signed = [("cookie", &*cookie)];
    assert_eq!(answered(&doors, "GET", "/v1/bases", &signed).await.0, StatusCode::OK);
    let bearer = format!("Bearer {admin}");
    let path = format!("/v1/keys/{id}");
    let (status, _, _) = answered(&doors, "DELETE", &path, &[("authorization", &bearer)]).await;
    assert_eq!(status, StatusCode::OK);
    let (status, _, refused) = answered(&doors, "GET", "/v1/bases", &signed).await;
    assert_eq!((status.as_u16(), code(&refused)), (401, "SIGN_IN_ENDED"));
    let (_, _, state) = answered(&doors, "GET", "/v1/sign-in", &signed).await;
    assert_eq!(state, json!({"needed": true, "rights": []}));
}
