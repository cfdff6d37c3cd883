//! Mutated answers of casters: heads, chunked bodies and sourcetables.
//!
//! Each target runs for half a second; `scripts/fuzz SECONDS` runs each longer, from other seeds.

use std::time::{Duration, Instant};

use super::chunked::Unchunker;
use super::head;
use super::sourcetable::{Sourcetable, is_whole};
use crate::feeds::head::HEAD_LIMIT;

/// A xorshift generator; Marsaglia (2003), *Xorshift RNGs*.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 % limit.max(1) as u64) as usize
    }
}

fn variable(name: &str, default: f64) -> f64 {
    std::env::var(name).map_or(default, |text| text.parse().expect("a number"))
}

/// Passes mutations of `seeds` to `check`, with a generator for further choices.
fn mutated(seeds: &[&[u8]], check: impl Fn(&[u8], &mut Random)) {
    let duration = Duration::from_secs_f64(variable("GRAPHFIX_FUZZ_S", 0.5));
    let mut random = Random(0x9e37_79b9_7f4a_7c15 ^ variable("GRAPHFIX_FUZZ_SEED", 1.0) as u64);
    let begun = Instant::now();
    for seed in seeds {
        check(seed, &mut random);
    }
    while begun.elapsed() < duration {
        let mut bytes = seeds[random.below(seeds.len())].to_vec();
        for _ in 0..=random.below(6) {
            let (at, other) = (random.below(bytes.len()), random.below(seeds.len()));
            let end = (at + 1 + random.below(12)).min(bytes.len());
            match random.below(6) {
                0 => bytes.truncate(at),
                1 => drop(bytes.drain(at..end)),
                2 => bytes.insert(at, random.below(256) as u8),
                3 => bytes.extend_from_slice(&seeds[other][random.below(seeds[other].len())..]),
                4 => bytes = bytes.repeat(1 + random.below(40)),
                _ if at < bytes.len() => bytes[at] = b"\r\n;:0 9fF-\xff\0"[random.below(12)],
                _ => {}
            }
            bytes.truncate(64 << 10);
        }
        check(&bytes, &mut random);
    }
}

#[test]
fn heads_never_panic_and_are_read_as_they_arrive() {
    let seeds: [&[u8]; 6] = [
        b"ICY 200 OK\r\n\xd3\x00\x13rest of the stream",
        b"HTTP/1.1 200 OK\r\nNtrip-Version: Ntrip/2.0\r\nTransfer-Encoding: chunked\r\n\r\n4\r\n",
        b"HTTP/1.1 503 Busy\r\nRetry-After: 7\r\nContent-Type: gnss/sourcetable\r\n\r\n",
        b"SOURCETABLE 200 OK\r\nContent-Length: 12\r\n\r\nSTR;A;B;C;D;",
        b"ERROR - Bad Password\r\n",
        b"HTTP/1.0 401 Unauthorized\nWWW-Authenticate: Basic\n\n",
    ];
    mutated(&seeds, |bytes, random| {
        let whole = head::read(bytes);
        if let Ok(Some(granted)) = &whole {
            assert!(granted.length <= bytes.len() && granted.length <= HEAD_LIMIT);
        }
        assert!(!(matches!(whole, Ok(None)) && HEAD_LIMIT <= bytes.len()), "it waits for ever");
        // If a part of a head is already granted, the whole head is granted in the same way.
        let part = head::read(&bytes[..random.below(bytes.len() + 1)]);
        if let Ok(Some(of_part)) = part {
            assert_eq!(whole.ok().flatten(), Some(of_part));
        }
        head::refusal(bytes);
    });
}

#[test]
fn chunked_bodies_never_panic_wherever_they_are_split() {
    let seeds: [&[u8]; 3] = [
        b"4\r\nabcd\r\n1a;name=value\r\nabcdefghijklmnopqrstuvwxyz\r\n0\r\n\r\n",
        b"ffffffff\r\nabc",
        b"0\r\nTrailer: x\r\n\r\n",
    ];
    mutated(&seeds, |bytes, random| {
        let (mut whole, mut at_once) = (Vec::new(), Unchunker::new());
        let result = at_once.push(bytes, &mut whole);
        let (mut parts, mut in_parts) = (Vec::new(), Unchunker::new());
        let (first, second) = bytes.split_at(random.below(bytes.len() + 1));
        let again =
            in_parts.push(first, &mut parts).and_then(|()| in_parts.push(second, &mut parts));
        assert_eq!((result, &whole), (again, &parts));
        assert_eq!(at_once.is_at_end(), in_parts.is_at_end());
        assert!(whole.len() <= bytes.len());
    });
}

#[test]
fn sourcetables_never_panic() {
    let seeds: [&[u8]; 2] = [
        b"CAS;a.example;2101;A;B;0;DEU;50.00;8.00\r\nSTR;AAAA0;Town;RTCM 3.2;1005(10),1077(1);2;\
          GPS+GLO;NET;IRL;53.28;-9.06;0;0;X;none;B;N;9;\r\nENDSOURCETABLE\r\n",
        b"STR;VRS;Net;RTCM 3;1004(1);2;GPS;NET;IRL;1e400;nan;1;1;X;none;B;N;9;\n",
    ];
    mutated(&seeds, |bytes, _| {
        is_whole(bytes);
        for mountpoint in Sourcetable::parse(bytes).mountpoints {
            let (latitude, longitude) = mountpoint.position_deg.unwrap_or_default();
            assert!(latitude.abs() <= 90.0 && longitude.abs() <= 360.0, "{mountpoint:?}");
        }
    });
}
