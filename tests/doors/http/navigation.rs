//! `/v1/navigation`.

use axum::http::StatusCode;
use serde_json::{Value, json};

use crate::support::casters::gzip;
use crate::support::doors::{Doors, code};

/// A GLONASS file written by hand, a record each quarter of an hour.
pub(crate) fn navigation(records: usize) -> Vec<u8> {
    let first = format!("{:>9}{:11}{:<20}{:<20}", "3.05", "", "N: GNSS NAV DATA", "M: MIXED");
    let mut text = format!("{first}RINEX VERSION / TYPE\n{:60}END OF HEADER\n", "");
    for index in 0..records {
        let (hour, minute) = (12 + index / 4, 15 * (index % 4));
        text += &format!("R01 2019 04 28 {hour:02} {minute:02} 00");
        text += " 1.000000000000e-05 0.000000000000e+00 4.500000000000e+04\n";
        for line in [
            " 1.000000000000e+04 1.000000000000e+00 0.000000000000e+00 0.000000000000e+00",
            " 2.000000000000e+04 1.000000000000e+00 0.000000000000e+00 1.000000000000e+00",
            " 1.200000000000e+04 2.000000000000e+00 0.000000000000e+00 0.000000000000e+00",
        ] {
            text += &format!("    {line}\n");
        }
    }
    text.into_bytes()
}

#[tokio::test]
async fn an_upload_is_counted_and_held() {
    let doors = Doors::open().await;
    let (status, answer) = doors.upload("/v1/navigation", navigation(1)).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    assert_eq!((&answer["ephemerides"], &answer["newEphemerides"]), (&json!(1), &json!(1)));
    let (_, again) = doors.upload("/v1/navigation", navigation(1)).await;
    assert_eq!(again["newEphemerides"], 0);
    let (_, held) = doors.get("/v1/navigation").await;
    assert_eq!(held["satellites"][0]["satellite"], "R01");
    // t_b is 12:45 UTC, 18 s earlier than GPS time.
    assert_eq!(held["satellites"][0]["coveredFrom"]["week"], 2051);
}

/// A packed file that is cut off gives the records of its whole lines, and says where it ends.
#[tokio::test]
async fn a_packed_file_that_is_cut_off_gives_what_is_there() {
    let doors = Doors::open().await;
    let (records, packed) = (40, gzip(&navigation(40)));
    let (status, answer) = doors.upload("/v1/navigation", packed[..packed.len() / 2].into()).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let ephemerides = answer["ephemerides"].as_u64().unwrap();
    assert!((1..records).contains(&ephemerides), "{answer}");
    let cut = answer["skipped"].as_array().unwrap().last().unwrap();
    let what = cut["what"].as_str().unwrap();
    assert!(what.starts_with("the gzip stream is cut off after "), "{answer}");
    assert!(what.ends_with(" unpacked bytes: what follows is missing"), "{answer}");
    assert_eq!((&cut["count"], &cut["firstLine"]), (&json!(1), &json!(0)));
    let (_, whole) = doors.upload("/v1/navigation", packed).await;
    assert_eq!(whole["newEphemerides"], json!(records - ephemerides));
    assert_eq!(whole["skipped"], json!([]));
}

/// Ephemerides serve all sessions: of a file whose gzip stream is damaged nothing is taken.
#[tokio::test]
async fn a_packed_file_that_is_damaged_or_empty_is_refused_as_a_whole() {
    let doors = Doors::open().await;
    let packed = gzip(&navigation(40));
    let checksum = packed.len() - 8;
    let mut damaged = packed.clone();
    damaged[checksum] ^= 1;
    let (status, refused) = doors.upload("/v1/navigation", damaged).await;
    assert_eq!((status.as_u16(), code(&refused)), (400, "RINEX_READ_FAILED"), "{refused}");
    let offset = refused["byteOffset"].as_u64().unwrap() as usize;
    assert!((checksum..=packed.len()).contains(&offset) && refused["line"].is_u64(), "{refused}");

    let header = gzip(&navigation(0));
    for (cut, what) in [(header.len() - 1, "no ephemeris"), (12, "should be")] {
        let (status, refused) = doors.upload("/v1/navigation", header[..cut].into()).await;
        assert_eq!((status.as_u16(), code(&refused)), (400, "RINEX_TRUNCATED"), "{refused}");
        let detail = refused["detail"].as_str().unwrap();
        assert!(detail.contains(&format!("{what}; the gzip stream is cut off after ")), "{detail}");
        assert_eq!(refused["byteOffset"], json!(cut));
    }
    let (_, stored): (_, Value) = doors.get("/v1/navigation").await;
    assert_eq!((&stored["ephemerides"], &stored["satellites"]), (&json!(0), &json!([])));
}
