//! Which replica a vehicle asks first, and which ones after it.

use egp_wire::keys::Name;

/// The replicas in the order in which this vehicle tries them, by rendezvous hashing.
///
/// Every client computes the same order without communication; vehicles spread evenly, and when a
/// replica leaves, only its own vehicles move. The hash of `fleet/vehicle@replica` is 64-bit FNV-1a with
/// the finaliser of MurmurHash3, highest first; ties, of which there are practically none, by name.
pub(crate) fn rank(fleet: &Name, vehicle: &Name, mut replicas: Vec<Name>) -> Vec<Name> {
    replicas.sort_by_cached_key(|replica| {
        let score = hash(format!("{fleet}/{vehicle}@{replica}").as_bytes());
        (std::cmp::Reverse(score), replica.clone())
    });
    replicas
}

fn hash(bytes: &[u8]) -> u64 {
    let fnv = bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
    });
    // FNV alone barely mixes the last bytes into the high bits, which decide the order.
    let mixed = (fnv ^ (fnv >> 33)).wrapping_mul(0xff51_afd7_ed55_8ccd);
    let mixed = (mixed ^ (mixed >> 33)).wrapping_mul(0xc4ce_b9fe_1a85_ec53);
    mixed ^ (mixed >> 33)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn names(count: usize) -> Vec<Name> {
        (0..count)
            .map(|i| format!("r{i}").parse().unwrap())
            .collect()
    }

    fn first_choices(replicas: &[Name]) -> Vec<Name> {
        let fleet = "f".parse().unwrap();
        (0..3000)
            .map(|i| {
                rank(
                    &fleet,
                    &format!("car{i}").parse().unwrap(),
                    replicas.to_vec(),
                )
                .remove(0)
            })
            .collect()
    }

    /// The published values of FNV-1a for these texts, after the published finaliser: a client in another language that
    /// computes these numbers chooses the same replica.
    #[test]
    fn the_hash_is_the_one_that_other_clients_compute() {
        assert_eq!(hash(b""), 0xefd0_1f60_ba99_2926);
        assert_eq!(hash(b"a"), 0x82a2_a958_a9be_ce5b);
        assert_eq!(hash(b"foobar"), 0x2c22_1949_22d1_672b);
    }

    #[test]
    fn vehicles_spread_evenly() {
        let choices = first_choices(&names(3));
        for replica in names(3) {
            let share = choices.iter().filter(|choice| **choice == replica).count();
            assert!((900..1100).contains(&share), "{replica}: {share}");
        }
    }

    #[test]
    fn only_the_vehicles_of_a_lost_replica_move() {
        let (all, fewer) = (names(4), names(3));
        for (before, after) in first_choices(&all).iter().zip(first_choices(&fewer)) {
            assert!(*before == after || *before == all[3]);
        }
    }
}
