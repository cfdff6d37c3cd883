//! Cost of the check of a key in each call.
//!
//! `cargo bench --bench keys` prints the time of one check, with few keys in memory and with many.

use std::hint::black_box;
use std::net::IpAddr;

use divan::Bencher;
use graphfix::keys::{Keys, NewKey, Right, Rights};
use graphfix::store::{Author, COMMAND_LINE, Store};
use graphfix::tenant::Tenant;

fn main() {
    divan::main();
}

/// A right key, beside `others` other ones.
#[divan::bench(args = [0, 1_000])]
fn right_key(bencher: Bencher<'_, '_>, others: usize) {
    let runtime = tokio::runtime::Runtime::new().expect("threads can be started");
    let folder = tempfile::tempdir().expect("a folder can be made");
    let url = format!("sqlite://{}", folder.path().join("keys.db").display());
    let (keys, secret) = runtime.block_on(async {
        let store = Store::open(&url).await.expect("the folder is writable");
        let keys = Keys::open(store).await.expect("the store is new");
        let author = Author {
            actor: COMMAND_LINE.to_owned(),
            tenant: Tenant::operator(),
            request: String::new(),
            node: String::new(),
        };
        let mut secret = None;
        for _ in 0..=others {
            let (tenant, label) = (Tenant::operator(), String::new());
            let rights = Rights::of(&[Right::Device]);
            let new = NewKey { tenant, rights, label, lifetime_ms: None };
            secret = Some(keys.create(new, &author).await.expect("there is room").secret);
        }
        (keys, secret.expect("one was created"))
    });
    let peer = Some(IpAddr::from([127, 0, 0, 1]));
    bencher.bench(|| black_box(&keys).admit(Some(black_box(secret.text())), peer).is_ok());
}
