//! Attempts with a wrong key, counted by the address of the sender.
//!
//! An address has [`BURST`] attempts at once, and then one in each [`INTERVAL`]. A right key is
//! never refused because of the attempts of others, since many devices may share one address.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

const BURST: u32 = 10;
const INTERVAL: Duration = Duration::from_secs(1);
/// Most addresses that are counted at the same time. All others share one count.
const ADDRESSES: usize = 4096;
/// The key of the count that all other addresses share.
const OTHERS: IpAddr = IpAddr::V6(Ipv6Addr::UNSPECIFIED);

/// For each address, the time until which its attempts are used up.
#[derive(Debug, Default)]
pub(super) struct Attempts(Mutex<HashMap<IpAddr, Instant>>);

impl Attempts {
    /// Counts an attempt from an address.
    ///
    /// # Errors
    /// The delay before the next attempt is allowed.
    pub(super) fn count(&self, address: IpAddr, now: Instant) -> Result<(), Duration> {
        let mut spent = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut address = network(address);
        if ADDRESSES <= spent.len() && !spent.contains_key(&address) {
            spent.retain(|_, until| now < *until);
            if ADDRESSES <= spent.len() {
                address = OTHERS;
            }
        }
        let until = spent.entry(address).or_insert(now);
        let next = (*until).max(now) + INTERVAL;
        match (next - now).checked_sub(INTERVAL * BURST) {
            Some(delay) if !delay.is_zero() => Err(delay),
            _ => {
                *until = next;
                Ok(())
            }
        }
    }
}

/// The network of an address: a host may use all addresses of its IPv6 prefix of 64 bits.
fn network(address: IpAddr) -> IpAddr {
    match address {
        IpAddr::V6(v6) => match v6.to_ipv4_mapped() {
            Some(v4) => IpAddr::V4(v4),
            None => IpAddr::V6(Ipv6Addr::from_bits(v6.to_bits() >> 64 << 64)),
        },
        v4 => v4,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(number: u32) -> IpAddr {
        IpAddr::V4(number.into())
    }

    #[test]
    fn an_address_has_a_burst_and_then_one_each_interval() {
        let (attempts, start) = (Attempts::default(), Instant::now());
        for _ in 0..BURST {
            attempts.count(address(1), start).unwrap();
        }
        assert_eq!(attempts.count(address(1), start), Err(INTERVAL));
        assert_eq!(attempts.count(address(1), start + INTERVAL / 4), Err(INTERVAL * 3 / 4));
        attempts.count(address(2), start).unwrap();
        attempts.count(address(1), start + INTERVAL).unwrap();
        attempts.count(address(1), start + INTERVAL).unwrap_err();
        for _ in 0..BURST {
            attempts.count(address(1), start + 100 * INTERVAL).unwrap();
        }
    }

    #[test]
    fn the_addresses_of_a_network_are_one() {
        let (attempts, now) = (Attempts::default(), Instant::now());
        let v6 = |text: &str| -> IpAddr { text.parse().unwrap() };
        for host in 0..BURST {
            attempts.count(v6(&format!("2001:db8:1:2::{host}")), now).unwrap();
        }
        assert!(attempts.count(v6("2001:db8:1:2:ffff::1"), now).is_err());
        assert!(attempts.count(v6("2001:db8:1:3::1"), now).is_ok());
        assert_eq!(network(v6("::ffff:192.0.2.1")), v6("192.0.2.1"));
    }

    /// Beyond the limit of addresses the memory does not grow, and used-up addresses stay used up.
    #[test]
    fn many_addresses_take_bounded_memory() {
        let (attempts, now) = (Attempts::default(), Instant::now());
        for _ in 0..BURST {
            attempts.count(address(0), now).unwrap();
        }
        let later = (1..3 * ADDRESSES as u32).map(|number| attempts.count(address(number), now));
        assert!(later.filter(Result::is_err).count() > ADDRESSES);
        assert!(attempts.0.lock().unwrap().len() <= ADDRESSES + 1);
        assert!(attempts.count(address(0), now).is_err());
        let after = now + BURST * INTERVAL;
        attempts.count(address(u32::MAX), after).unwrap();
        assert_eq!(attempts.0.lock().unwrap().len(), 1);
    }
}
