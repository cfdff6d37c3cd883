//! `/v1/sessions`.

use axum::body::Body;
use axum::http::{Request, StatusCode};
use graphfix::config::Limits;
use serde_json::{Value, json};
use tower::ServiceExt;

use crate::support::doors::{Doors, code, epoch};

#[tokio::test]
async fn a_session_is_created_changed_and_closed() {
    let doors = Doors::open().await;
    let new = json!({"label": "rover 7", "overrides": {"elevation_mask_deg": "10"}});
    let (status, created) = doors.post("/v1/sessions", new).await;
    assert_eq!(status, StatusCode::CREATED, "{created}");
    assert_eq!((&created["mode"], &created["profile"]), (&json!("spp"), &json!("general")));
    let options = created["configuration"].as_array().unwrap();
    let mask = options.iter().find(|option| option["name"] == "elevation_mask_deg").unwrap();
    assert_eq!(mask["value"], "10");

    let path = format!("/v1/sessions/{}", created["session"].as_str().unwrap());
    assert_eq!(doors.get(&path).await, (StatusCode::OK, created.clone()));

    let change = json!({"label": "rover 8", "clearOverrides": ["elevation_mask_deg"]});
    let (status, changed) = doors.send("PATCH", &path, change).await;
    assert_eq!((status, &changed["label"]), (StatusCode::OK, &json!("rover 8")));
    assert_eq!(changed["overrides"], json!({}));
    assert_ne!(changed["configurationHash"], created["configurationHash"]);

    let (status, closed) = doors.send("DELETE", &path, json!({})).await;
    assert_eq!((status, &closed["closed"]), (StatusCode::OK, &json!(true)));
    let (status, refused) = doors.send("PATCH", &path, json!({"label": "x"})).await;
    assert_eq!((status, code(&refused)), (StatusCode::CONFLICT, "SESSION_CLOSED"));
}

/// A misspelt name would leave the override that was meant.
#[tokio::test]
async fn an_unknown_option_is_not_cleared() {
    let doors = Doors::open().await;
    let new = json!({"label": "rover 7", "overrides": {"elevation_mask_deg": "10"}});
    let (_, created) = doors.post("/v1/sessions", new).await;
    let path = format!("/v1/sessions/{}", created["session"].as_str().unwrap());
    let change = json!({"label": "boat", "clearOverrides": ["elevation_mask"]});
    let (status, refused) = doors.send("PATCH", &path, change).await;
    assert_eq!((status, code(&refused)), (StatusCode::BAD_REQUEST, "UNKNOWN_OPTION"));
    assert_eq!(refused["field"], "clearOverrides");
    assert_eq!(doors.get(&path).await.1, created, "nothing is changed");
    // An option that is not overridden may be cleared, as when the request is sent again.
    let change = json!({"clearOverrides": ["window_s"]});
    assert_eq!(doors.send("PATCH", &path, change).await.0, StatusCode::OK);
}

#[tokio::test]
async fn a_purged_session_is_gone() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let path = format!("/v1/sessions/{session}");
    let (status, refused) = doors.send("DELETE", &format!("{path}?purge=perhaps"), json!({})).await;
    assert_eq!((status, code(&refused)), (StatusCode::BAD_REQUEST, "INVALID_FIELD"));
    let (status, purged) = doors.send("DELETE", &format!("{path}?purge=true"), json!({})).await;
    assert_eq!((status, &purged["session"]), (StatusCode::OK, &json!(session)));
    let (status, refused) = doors.get(&path).await;
    assert_eq!((status, code(&refused)), (StatusCode::NOT_FOUND, "SESSION_NOT_FOUND"));
}

#[tokio::test]
async fn sessions_are_listed_page_by_page() {
    let doors = Doors::open().await;
    let mut created = Vec::new();
    for _ in 0..3 {
        created.insert(0, doors.session().await);
    }
    let (_, first) = doors.get("/v1/sessions?pageSize=2").await;
    let token = first["nextPageToken"].as_str().unwrap();
    let (_, second) = doors.get(&format!("/v1/sessions?pageSize=2&pageToken={token}")).await;
    let listed =
        [&first, &second].into_iter().flat_map(|page| page["sessions"].as_array().unwrap());
    let listed: Vec<_> = listed.map(|session| session["session"].as_str().unwrap()).collect();
    assert_eq!(listed, created);
    assert_eq!(second["nextPageToken"], "");
}

/// A list shows what is asked for, in pages of their own, and its view leaves the options out.
#[tokio::test]
async fn a_list_has_what_is_asked_for() {
    let doors = Doors::open().await;
    let mut ids = Vec::new();
    for (label, mode) in [("a", "spp"), ("b", "fgo"), ("a", "fgo"), ("a", "fgo")] {
        let new = json!({"label": label, "mode": mode});
        let (_, session) = doors.post("/v1/sessions", new).await;
        ids.push(session["session"].as_str().unwrap().to_owned());
    }
    doors.send("DELETE", &format!("/v1/sessions/{}", ids[0]), json!({})).await;
    let listed = async |list: &str, path: &str| {
        let (status, page) = doors.get(path).await;
        assert_eq!(status, StatusCode::OK, "{path}: {page}");
        let items = page[list].as_array().unwrap();
        let index = |item: &serde_json::Value| ids.iter().position(|id| item["session"] == **id);
        items.iter().map(|item| index(item).unwrap()).collect::<Vec<_>>()
    };
    for (query, expected) in [
        ("order=OLDEST_FIRST", vec![0, 1, 2, 3]),
        ("order=NEWEST_FIRST", vec![3, 2, 1, 0]),
        ("closed=true", vec![0]),
        ("closed=false", vec![3, 2, 1]),
        ("mode=fgo&label=a", vec![3, 2]),
        ("label=", vec![3, 2, 1, 0]),
        ("mode=ekf", vec![]),
    ] {
        for (list, path) in [("sessions", "/v1/sessions"), ("heads", "/v1/sessions:heads")] {
            assert_eq!(listed(list, &format!("{path}?{query}")).await, expected, "{path} {query}");
        }
    }
    let oldest = "/v1/sessions?pageSize=1&order=OLDEST_FIRST&closed=false";
    let (_, page) = doors.get(&format!("{oldest}&view=BASIC")).await;
    assert_eq!(page["sessions"][0]["configuration"], json!([]));
    assert_eq!(page["sessions"][0]["mode"], "fgo");
    let token = page["nextPageToken"].as_str().unwrap();
    let next = format!("{oldest}&view=BASIC&pageToken={token}");
    assert_eq!(listed("sessions", &next).await, [2]);
    let (_, page) = doors.get(oldest).await;
    assert!(20 < page["sessions"][0]["configuration"].as_array().unwrap().len());
    for query in [
        format!("pageToken={token}"),
        "view=basic".to_owned(),
        "order=NEWEST".to_owned(),
        "closed=1".to_owned(),
        "pageSize=1001".to_owned(),
    ] {
        let (status, refused) = doors.get(&format!("/v1/sessions?{query}")).await;
        assert_eq!(status, StatusCode::BAD_REQUEST, "{query}: {refused}");
    }
}

/// Heads have the last epoch and the latest position, the newest session first.
#[tokio::test]
async fn heads_show_the_last_epoch() {
    let doors = Doors::open().await;
    let (silent, active) = (doors.session().await, doors.session().await);
    let epochs: Vec<_> = (1..=3).map(epoch).collect();
    doors.post(&format!("/v1/sessions/{active}/epochs"), json!({"epochs": epochs})).await;
    let (status, first) = doors.get("/v1/sessions:heads?pageSize=1").await;
    assert_eq!(status, StatusCode::OK, "{first}");
    let head = &first["heads"][0];
    assert_eq!((&head["session"], &head["lastSeq"]), (&json!(active), &json!(3)));
    assert_eq!((&head["status"], &head["label"]), (&json!("NONE"), &json!("rover")));
    assert_eq!(head["lastTime"], json!({"week": 2051, "nsOfWeek": 46_704_000_000_000_u64}));
    assert_eq!(head["position"], json!(null));
    // The epochs are of 2019.
    assert!(head["ageS"].as_f64().is_some_and(|age_s| 3.15e7 < age_s), "{head}");

    let token = first["nextPageToken"].as_str().unwrap();
    let (_, second) = doors.get(&format!("/v1/sessions:heads?pageSize=1&pageToken={token}")).await;
    let head = &second["heads"][0];
    assert_eq!((&head["session"], &second["nextPageToken"]), (&json!(silent), &json!("")));
    assert_eq!((&head["status"], &head["ageS"]), (&json!("UNSPECIFIED"), &json!(null)));

    for query in ["pageSize=10001", "pageToken=ses_0"] {
        let (status, refused) = doors.get(&format!("/v1/sessions:heads?{query}")).await;
        assert_eq!(status, StatusCode::BAD_REQUEST, "{refused}");
    }
}

/// The answers of readers that read nothing take memory from the budget of requests: pages become
/// shorter, and then every list is refused until there is memory again.
#[tokio::test]
async fn lists_take_memory_of_the_budget() {
    let doors = Doors::with(Limits { request_memory_bytes: 16 << 20, ..Limits::standard() }).await;
    for _ in 0..200 {
        doors.session().await;
    }
    let count = |page: &Value| page["sessions"].as_array().map_or(0, Vec::len);
    let full = "/v1/sessions?pageSize=1000";
    let (_, first) = doors.get(full).await;
    // 8 MB at 64 kB a session.
    assert_eq!(count(&first), 128);
    let token = first["nextPageToken"].as_str().unwrap();
    let (_, rest) = doors.get(&format!("{full}&pageToken={token}")).await;
    assert_eq!((count(&rest), &rest["nextPageToken"]), (72, &json!("")));
    assert_eq!(count(&doors.get(&format!("{full}&view=BASIC")).await.1), 200);

    let unread = async || {
        let request = Request::get(full).body(Body::empty()).unwrap();
        doors.router.clone().oneshot(request).await.unwrap()
    };
    let (one, other) = (unread().await, unread().await);
    let lists = ["sessions", "jobs", "keys", "audit", "bases", "tenants"];
    for list in lists {
        let (status, refused) = doors.get(&format!("/v1/{list}?pageSize=1000")).await;
        let outcome = (status, code(&refused));
        assert_eq!(outcome, (StatusCode::TOO_MANY_REQUESTS, "MEMORY_EXHAUSTED"), "{list}");
    }
    drop(one);
    for list in lists {
        let (status, answer) = doors.get(&format!("/v1/{list}?pageSize=1000")).await;
        assert_eq!(status, StatusCode::OK, "{list}: {answer}");
    }
    // A page that ends early for want of memory.
    let bytes = axum::body::to_bytes(other.into_body(), usize::MAX).await.unwrap();
    assert_eq!(count(&serde_json::from_slice(&bytes).unwrap()), 48);
}
