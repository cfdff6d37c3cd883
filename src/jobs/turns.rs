//! Whose job is claimed next: that of the tenant whose jobs have used the least processor time
//! while others had jobs, too.
//!
//! A tenant that comes with a job begins at the time of those that are there, so it has no claim to
//! the time before (stride scheduling, as in the solver pool).

use std::collections::HashMap;

use crate::tenant::Tenant;

/// The tenants with jobs.
#[derive(Debug, Default)]
pub(super) struct TenantTurns {
    present: HashMap<Tenant, Present>,
    /// Virtual time: that of the tenant that was chosen last (s).
    now_s: f64,
}

/// A tenant with jobs that wait or run.
#[derive(Debug)]
struct Present {
    /// Its virtual time (s).
    pass_s: f64,
    /// The time that its jobs had used when the virtual time was set (s).
    used_s: f64,
    running: usize,
}

impl TenantTurns {
    /// The one of the tenants whose jobs wait that comes next. `used_s` is the time that the jobs
    /// of a tenant have used since the start of the service (s).
    pub(super) fn next(
        &mut self,
        waiting: &[Tenant],
        used_s: impl Fn(&Tenant) -> f64,
    ) -> Option<Tenant> {
        self.present.retain(|tenant, present| 0 < present.running || waiting.contains(tenant));
        for (tenant, present) in &mut self.present {
            let used = used_s(tenant);
            present.pass_s += used - present.used_s;
            present.used_s = used;
        }
        for tenant in waiting {
            let new = || Present { pass_s: self.now_s, used_s: used_s(tenant), running: 0 };
            self.present.entry(tenant.clone()).or_insert_with(new);
        }
        // What runs and is not used yet counts as much as what the others run.
        let rank = |tenant: &&Tenant| {
            let present = &self.present[*tenant];
            (present.running, present.pass_s)
        };
        let next = waiting.iter().min_by(|a, b| {
            let ((running, pass_s), (others, others_s)) = (rank(a), rank(b));
            running.cmp(&others).then(pass_s.total_cmp(&others_s)).then(a.cmp(b))
        });
        let next = next?.clone();
        let present = self.present.get_mut(&next)?;
        present.running += 1;
        self.now_s = self.now_s.max(present.pass_s);
        Some(next)
    }

    /// A job of a tenant that was chosen no longer runs.
    pub(super) fn end(&mut self, tenant: &Tenant) {
        if let Some(present) = self.present.get_mut(tenant) {
            present.running = present.running.saturating_sub(1);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    fn tenant(name: &str) -> Tenant {
        Tenant::parse(name).unwrap()
    }

    /// One job at a time; `jobs` are the lengths of the jobs of each tenant (s). Returns the time
    /// that each has used until one of them has none left.
    fn used(mut jobs: BTreeMap<Tenant, Vec<f64>>) -> BTreeMap<Tenant, f64> {
        let (mut turns, mut used) = (TenantTurns::default(), BTreeMap::new());
        while jobs.values().all(|jobs| !jobs.is_empty()) {
            let waiting: Vec<Tenant> = jobs.keys().cloned().collect();
            let of = |tenant: &Tenant| used.get(tenant).copied().unwrap_or(0.0);
            let next = turns.next(&waiting, of).unwrap();
            *used.entry(next.clone()).or_insert(0.0) += jobs.get_mut(&next).unwrap().remove(0);
            turns.end(&next);
        }
        used
    }

    /// Each of two tenants has half of the time, whatever the length and number of its jobs.
    #[test]
    fn tenants_have_the_same_time() {
        let [a, b] = ["a", "b"].map(tenant);
        let jobs = BTreeMap::from([(a.clone(), vec![7.0; 50]), (b.clone(), vec![1.0; 350])]);
        let used = used(jobs);
        let part = used[&a] / (used[&a] + used[&b]);
        assert!((0.45..=0.55).contains(&part), "{part}");
    }

    #[test]
    fn a_tenant_that_comes_has_no_claim_to_the_past() {
        let [a, b] = ["a", "b"].map(tenant);
        let (mut turns, mut used) = (TenantTurns::default(), BTreeMap::from([(a.clone(), 0.0)]));
        for _ in 0..100 {
            let next = turns.next(std::slice::from_ref(&a), |tenant| used[tenant]).unwrap();
            *used.get_mut(&next).unwrap() += 10.0;
            turns.end(&next);
        }
        used.insert(b.clone(), 0.0);
        let mut served = Vec::new();
        for _ in 0..6 {
            let next = turns.next(&[a.clone(), b.clone()], |tenant| used[tenant]).unwrap();
            *used.get_mut(&next).unwrap() += 10.0;
            turns.end(&next);
            served.push(next);
        }
        assert_eq!(served.iter().filter(|tenant| **tenant == b).count(), 3, "{served:?}");
    }

    /// While a tenant has a job running, the other one's comes next.
    #[test]
    fn a_tenant_does_not_take_all_runs() {
        let [a, b] = ["a", "b"].map(tenant);
        let mut turns = TenantTurns::default();
        let both = [a.clone(), b.clone()];
        let mut next = || turns.next(&both, |_| 0.0).unwrap();
        assert_eq!([next(), next(), next()], [a.clone(), b, a]);
    }
}
