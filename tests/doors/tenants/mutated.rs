//! Ten thousand damaged calls for things of a tenant, with keys that are wrong, have expired, are
//! revoked or belong to another tenant: clear refusals, and nothing learnt or changed.

use std::collections::BTreeMap;

use axum::body::{Body, to_bytes};
use axum::http::Request;
use graphfix::contract::access::{CALLS, Need};
use serde_json::json;

use crate::support::database::Database;
use crate::support::doors::Doors;
use crate::support::streams::{Random, mutate};
use crate::support::wait::until;

use super::cases::{Case, case};
use super::world::{Key, MARK, asked, furnished, key_of, operator, seen, sent};

const ROUNDS: usize = 10_000;

/// A request with a damaged body, or none.
async fn damaged(request: Request<Body>, random: &mut Random) -> Request<Body> {
    let (parts, body) = request.into_parts();
    let mut bytes = to_bytes(body, usize::MAX).await.unwrap().to_vec();
    // The damage is after the five-byte prefix of a gRPC message, so that most messages are
    // decoded.
    let is_grpc = parts.headers.get("content-type").is_some_and(|kind| kind == "application/grpc");
    if is_grpc && 5 < bytes.len() && random.below(4) != 0 {
        let mut message = bytes.split_off(5);
        mutate(&mut message, random);
        let length = u32::try_from(message.len()).unwrap().to_be_bytes();
        bytes[1..5].copy_from_slice(&length);
        bytes.extend(message);
    } else {
        mutate(&mut bytes, random);
    }
    Request::from_parts(parts, Body::from(bytes))
}

/// A key whose secret differs in one digit.
fn mistyped(key: &Key, random: &mut Random) -> Key {
    let mut secret = key.secret.clone().into_bytes();
    let index = 4 + random.below(secret.len() - 4);
    secret[index] = if secret[index] == b'0' { b'1' } else { b'0' };
    Key { id: key.id.clone(), secret: String::from_utf8(secret).unwrap() }
}

pub(super) async fn ten_thousand_mutated_calls_learn_and_change_nothing(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let other = key_of(&doors, &operator, "strangers", MARK).await;
    let owned = furnished(&doors, &other, "strangers").await;
    let [foreign, expired, revoked] =
        ["a", "strangers", "strangers"].map(|tenant| key_of(&doors, &operator, tenant, ""));
    let (foreign, expired, revoked) = (foreign.await, expired.await, revoked.await);
    let path = format!("/v1/keys/{}", revoked.id);
    assert!(asked(&doors, &operator, "DELETE", &path, json!(null)).await.0.is_success());
    database.execute("UPDATE api_key_changes SET number = number + 1").await;
    let expire = format!(
        "UPDATE api_keys SET expires_unix_ms = 1, \
         changed = (SELECT number FROM api_key_changes) WHERE id = '{}'",
        expired.id
    );
    database.execute(&expire).await;
    let of_expired = async || asked(&doors, &expired, "GET", "/v1/sessions", json!(null)).await.1;
    until("expired", of_expired, |answer| answer["code"] == "KEY_EXPIRED").await;
    let before = seen(&doors, &other, &owned).await;

    let mut random = Random::new(0x9e37_79b9_7f4a_7c15);
    let mut codes = BTreeMap::<String, usize>::new();
    for round in 0..ROUNDS {
        let call = &CALLS[round % CALLS.len()];
        let Case::Requests(mut requests) = case(call, &owned) else { continue };
        let request = requests.swap_remove(random.below(requests.len()));
        let request = match random.below(3) {
            0 => request,
            _ => damaged(request, &mut random).await,
        };
        let what = format!("{} {}", request.method(), request.uri());
        let (key, expected) = match random.below(5) {
            0 => (mistyped(&other, &mut random), Some("KEY_INVALID")),
            1 => (expired.clone(), Some("KEY_EXPIRED")),
            2 => (revoked.clone(), Some("KEY_REVOKED")),
            _ => (foreign.clone(), None),
        };
        let answer = sent(&doors, &key, request).await;
        let code = answer.refusal.as_ref().map(|(code, _)| code.clone());
        assert!(answer.status.as_u16() < 500, "{what}: {answer:?}");
        assert!(!answer.text.contains(MARK), "{what}: {answer:?}");
        for failed in ["INTERNAL", "DATABASE_FAILED", "STORED_DATA_CORRUPT"] {
            assert_ne!(code.as_deref(), Some(failed), "{what}: {answer:?}");
        }
        match expected.filter(|_| call.need != Need::Nothing) {
            Some(expected) => assert_eq!(code.as_deref(), Some(expected), "{what}: {answer:?}"),
            None if code.is_none() => {
                for id in [&owned.session, &owned.base, &owned.job, &owned.key] {
                    assert!(!answer.text.contains(&**id), "{what} shows {id}: {}", answer.text);
                }
            }
            None => {}
        }
        *codes.entry(code.unwrap_or_default()).or_default() += 1;
    }
    // Refusals because of the key, because of an unknown object, and because of the damage.
    for code in ["KEY_INVALID", "KEY_EXPIRED", "KEY_REVOKED", "SESSION_NOT_FOUND", "MALFORMED_BODY"]
    {
        assert!(100 < codes[code], "{code}: {codes:?}");
    }
    // Names of keys that were refused are in the tenant's own audit log.
    let without_audit = |seen: &[(String, serde_json::Value)]| {
        let kept = seen.iter().filter(|(path, _)| path != "/v1/audit");
        kept.cloned().collect::<Vec<_>>()
    };
    let after = seen(&doors, &other, &owned).await;
    assert_eq!(without_audit(&after), without_audit(&before), "something has changed");
    assert_eq!(doors.service.budget().used(), 0);
    doors.close().await;
}
