//! `/v1/navigation`.

use axum::http::StatusCode;
use serde_json::json;

use crate::support::doors::Doors;

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
