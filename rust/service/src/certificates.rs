//! Validity and owners of the certificates that zenoh's TLS settings name.

use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use egp_wire::read_regular;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::{Registry, Unit};
use serde_json::Value;
use x509_parser::pem::Pem;

use crate::configuration::{MAP, SERVICE};

/// Number of days before the expiry of a certificate from which a service warns of it.
const SOON: i64 = 30;
/// Largest number of bytes that are read of a file of certificates.
const LARGEST: u64 = 16 << 20;
/// A day, s.
const DAY: i64 = 24 * 3600;

/// The settings of zenoh's TLS that name certificates.
pub(crate) const SETTINGS: [&str; 6] = [
    "root_ca_certificate",
    "root_ca_certificate_base64",
    "listen_certificate",
    "listen_certificate_base64",
    "connect_certificate",
    "connect_certificate_base64",
];

/// A certificate that cannot be used: the setting that names it, and the reason.
pub(crate) type Unusable = (String, String);

/// The names that `egp keys` writes into certificates, each also the name of a file. A vehicle's is `FLEET/VEHICLE`.
const ROLES: [&str; 4] = [SERVICE, MAP, "router", "operator"];
/// The role of a vehicle.
const VEHICLE: &str = "vehicle";

/// What is read from a certificate.
struct Certificate {
    /// First and last time at which it is valid, s since 1970.
    begin: i64,
    end: i64,
    /// The day of `begin`.
    from: String,
    /// The common name of its owner, if it has one.
    owner: Option<String>,
}

/// The earliest end of the certificates in these settings ([`SETTINGS`], with their values), s since 1970; none if they name
/// none. A file of authorities is valid from the first begin to the last end, and a chain as long as its first certificate,
/// which is the service's own. `now` is in s since 1970, too. `role` is the name of this program in [`ROLES`], or [`VEHICLE`]; without
/// one the certificate may be that of any role.
///
/// # Errors
/// [`Unusable`] for a file that cannot be read, has no certificate, has one that has expired or is not valid yet, or, as
/// this program's own, one of another role.
pub(crate) fn earliest_end(
    settings: &[(String, Value)],
    now: i64,
    role: Option<&str>,
) -> Result<Option<i64>, Unusable> {
    let mut earliest = None;
    for (key, value) in settings {
        let Some(text) = value.as_str() else {
            continue;
        };
        let end = end(key, text, now, role).map_err(|reason| {
            let named = if key.ends_with("_base64") {
                key.clone()
            } else {
                format!("{key} {text}")
            };
            (named, reason)
        })?;
        earliest = Some(earliest.map_or(end, |earliest: i64| earliest.min(end)));
    }
    Ok(earliest)
}

/// The end of the certificates of one setting, for [`earliest_end`], or the reason why they cannot be used.
fn end(key: &str, text: &str, now: i64, role: Option<&str>) -> Result<i64, String> {
    let content = if key.ends_with("_base64") {
        decode(text)
    } else {
        read_regular(Path::new(text), LARGEST).map_err(|error| error.to_string())
    };
    let found = certificates(&content?)?;
    let authorities = key.contains("root_ca");
    let (first, last) = if authorities {
        (
            found.iter().min_by_key(|one| one.begin),
            found.iter().max_by_key(|one| one.end),
        )
    } else {
        (found.first(), found.first())
    };
    let (Some(first), Some(last)) = (first, last) else {
        return Err("expected a certificate in PEM, got none".to_owned());
    };
    if first.begin > now {
        return Err(format!(
            "the certificate is valid only from {}; check this machine's clock",
            first.from
        ));
    }
    if last.end <= now {
        return Err(format!(
            "the certificate expired {} ago; renew it with `egp keys`",
            in_days((now - last.end) / DAY)
        ));
    }
    let owner = first.owner.as_deref().and_then(role_of);
    if let (Some(owner), Some(role)) = (owner, role)
        && owner != role
        && !authorities
    {
        let file = if role == VEHICLE {
            "vehicles/FLEET@VEHICLE"
        } else {
            role
        };
        return Err(format!(
            "the certificate is that of the role {owner}, and this program has the role {role}; state the file \
             {file}.json5 of `egp keys`"
        ));
    }
    Ok(last.end)
}

/// The role for which `egp keys` writes a certificate with this name; none if it writes no such certificate.
fn role_of(owner: &str) -> Option<&str> {
    if owner.contains('/') {
        return Some(VEHICLE);
    }
    Some(owner).filter(|owner| ROLES.contains(owner))
}

/// The time, s since 1970.
pub(crate) fn now() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    i64::try_from(since.unwrap_or_default().as_secs()).unwrap_or(i64::MAX)
}

/// Shows in a metric when the first certificate expires, s since 1970, and warns if it is time to renew it.
pub(crate) fn show(end: i64, registry: &mut Registry) {
    let gauge = Gauge::<i64>::default();
    gauge.set(end);
    let help = "Unix time at which the first certificate of the network expires";
    registry.register_with_unit("certificate_expiry", help, Unit::Seconds, gauge);
    if let Some(warning) = warning(end, now()) {
        tracing::warn!("{warning}");
    }
}

/// A warning about a certificate with this end; none if it is not yet time to renew it.
pub(crate) fn warning(end: i64, now: i64) -> Option<String> {
    let days = days_left(end, now)?;
    Some(format!(
        "a certificate expires in {}; renew it with `egp keys`",
        in_days(days)
    ))
}

fn in_days(days: i64) -> String {
    format!("{days} day{}", if days == 1 { "" } else { "s" })
}

/// The days until a certificate with this end expires, if it is time to renew it.
fn days_left(end: i64, now: i64) -> Option<i64> {
    let days = (end - now) / DAY;
    (days < SOON).then_some(days)
}

/// The bytes that a text of Base64 stands for, read as the content of a block of PEM.
fn decode(base64: &str) -> Result<Vec<u8>, String> {
    let block = format!("-----BEGIN TEXT-----\n{base64}\n-----END TEXT-----\n");
    let read = Pem::iter_from_buffer(block.as_bytes()).next();
    read.map_or(Ok(Vec::new()), |pem| {
        Ok(pem.map_err(|error| error.to_string())?.contents)
    })
}

/// The certificates of a text in PEM.
fn certificates(pem: &[u8]) -> Result<Vec<Certificate>, String> {
    let mut found = Vec::new();
    for block in Pem::iter_from_buffer(pem) {
        let block = block.map_err(|error| error.to_string())?;
        if block.label == "CERTIFICATE" {
            let read = block.parse_x509().map_err(|error| error.to_string())?;
            let validity = read.validity();
            let owner = read.subject().iter_common_name().next();
            found.push(Certificate {
                begin: validity.not_before.timestamp(),
                end: validity.not_after.timestamp(),
                from: validity.not_before.to_datetime().date().to_string(),
                owner: owner.and_then(|name| name.as_str().ok().map(str::to_owned)),
            });
        }
    }
    Ok(found)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::fs;

    use super::*;
    use crate::configuration::configuration;

    /// A certificate that ends at [`END`].
    const PEM: &str = "-----BEGIN CERTIFICATE-----
MIHQMIGDoAMCAQICAQEwBQYDK2VwMBIxEDAOBgNVBAMMB2V4cGlyZWQwHhcNMTkw
MTAxMDAwMDAwWhcNMjAwMTAxMDAwMDAwWjASMRAwDgYDVQQDDAdleHBpcmVkMCow
BQYDK2VwAyEAQdqshgKG/qRej6mJbH2cHM05XEtP/G3pmwK1drdYtkMwBQYDK2Vw
A0EA4MYKrYCa9pIgWQp7HAcaUbZm3X62PtRLzH+JIrVika414j6G0LOW1vMy4XY8
do6S23DDFe9OW8P2HIfrrhcdDw==
-----END CERTIFICATE-----
";
    /// 2020-01-01 00:00:00 UTC.
    const END: i64 = 1_577_836_800;
    /// 2019-01-01 00:00:00 UTC.
    const BEGIN: i64 = 1_546_300_800;

    fn setting(key: &str, value: &str) -> Vec<(String, Value)> {
        vec![(key.to_owned(), Value::from(value))]
    }

    #[test]
    fn a_certificate_is_used_until_it_expires() {
        let file = std::env::temp_dir().join(format!("egp-{}.pem", std::process::id()));
        fs::write(&file, PEM).unwrap();
        let key = "transport/link/tls/listen_certificate";
        let named = setting(key, file.to_str().unwrap());
        assert_eq!(
            earliest_end(&named, END - 1, Some("service")),
            Ok(Some(END))
        );
        let (what, reason) = earliest_end(&named, END + 200_000, Some("service")).unwrap_err();
        assert!(what.contains(key) && what.contains("egp-"), "{what}");
        assert!(reason.contains("expired 2 days ago"), "{reason}");
        fs::write(&file, "no certificate").unwrap();
        let (_, reason) = earliest_end(&named, 0, Some("service")).unwrap_err();
        assert!(reason.contains("got none"), "{reason}");
        fs::remove_file(&file).unwrap();
        assert!(earliest_end(&named, 0, Some("service")).is_err());
        let none = vec![(key.to_owned(), Value::Null)];
        assert_eq!(earliest_end(&none, 0, Some("service")), Ok(None));
    }

    #[test]
    fn certificates_inside_the_settings_are_read() {
        assert_eq!(decode("YWJj").unwrap(), b"abc");
        let named = setting("transport/link/tls/connect_certificate_base64", BASE64);
        assert_eq!(
            earliest_end(&named, END - 1, Some("service")),
            Ok(Some(END))
        );
        assert!(
            earliest_end(
                &setting("root_ca_certificate_base64", "YWJj"),
                0,
                Some("service")
            )
            .is_err()
        );
    }

    #[test]
    fn a_configuration_with_an_expired_certificate_is_an_error() {
        let key = "transport/link/tls/connect_certificate_base64".to_owned();
        let values = [(key, format!("\"{BASE64}\""))].into();
        let error = configuration(None, &values, Some("service"))
            .unwrap_err()
            .to_string();
        assert!(error.contains("the certificate expired"), "{error}");
    }

    #[test]
    fn a_certificate_that_is_not_valid_yet_is_an_error() {
        for key in ["root_ca_certificate_base64", "connect_certificate_base64"] {
            let named = setting(key, BASE64);
            let (what, reason) = earliest_end(&named, BEGIN - 1, Some("service")).unwrap_err();
            assert_eq!(what, key);
            assert!(
                reason.contains("valid only from 2019-01-01; check this machine's clock"),
                "{reason}"
            );
            assert_eq!(earliest_end(&named, BEGIN, Some("service")), Ok(Some(END)));
        }
    }

    #[test]
    fn the_certificate_of_another_role_is_an_error_unless_it_is_an_authoritys() {
        let named = |key| earliest_end(&setting(key, OF_MAP), BEGIN, Some("service"));
        for key in ["listen_certificate_base64", "connect_certificate_base64"] {
            let (_, reason) = named(key).unwrap_err();
            assert!(
                reason.contains("the role map") && reason.contains("state the file service.json5"),
                "{reason}"
            );
        }
        assert_eq!(named("root_ca_certificate_base64"), Ok(Some(END)));
        for (owner, role) in [
            ("default/car-1", Some("vehicle")),
            ("operator", Some("operator")),
            ("www.example.org", None),
        ] {
            assert_eq!(role_of(owner), role);
        }
        let own = setting("listen_certificate_base64", OF_MAP);
        assert_eq!(earliest_end(&own, BEGIN, Some("map")), Ok(Some(END)));
        // The name of a certificate that `egp keys` did not write may be any other one.
        let other = setting("listen_certificate_base64", BASE64);
        assert_eq!(earliest_end(&other, BEGIN, Some("service")), Ok(Some(END)));
    }

    #[test]
    fn a_certificate_ends_soon_thirty_days_before() {
        assert_eq!(days_left(END, END - 30 * DAY), None);
        assert_eq!(days_left(END, END - 30 * DAY + 1), Some(29));
    }

    /// [`PEM`].
    const BASE64: &str = "LS0tLS1CRUdJTiBDRVJUSUZJQ0FURS0tLS0tCk1JSFFNSUdEb0FNQ0FRSUNBUUV3QlFZREsyVndNQkl4RURBT0JnTlZCQU1NQjJW\
        NGNHbHlaV1F3SGhjTk1Ua3cKTVRBeE1EQXdNREF3V2hjTk1qQXdNVEF4TURBd01EQXdXakFTTVJBd0RnWURWUVFEREFkbGVIQnBj\
        bVZrTUNvdwpCUVlESzJWd0F5RUFRZHFzaGdLRy9xUmVqNm1KYkgyY0hNMDVYRXRQL0czcG13SzFkcmRZdGtNd0JRWURLMlZ3CkEw\
        RUE0TVlLcllDYTlwSWdXUXA3SEFjYVViWm0zWDYyUHRSTHpIK0pJclZpa2E0MTRqNkcwTE9XMXZNeTRYWTgKZG82UzIzRERGZTlP\
        VzhQMkhJZnJyaGNkRHc9PQotLS0tLUVORCBDRVJUSUZJQ0FURS0tLS0tCg==";

    /// A certificate as that of [`PEM`], with the common name `map`.
    const OF_MAP: &str = "LS0tLS1CRUdJTiBDRVJUSUZJQ0FURS0tLS0tCk1JSEhNSHVnQXdJQkFnSUJBVEFGQmdNclpYQXdEakVNTUFvR0ExVUVBd3dEYldG\
        d01CNFhEVEU1TURFd01UQXcKTURBd01Gb1hEVEl3TURFd01UQXdNREF3TUZvd0RqRU1NQW9HQTFVRUF3d0RiV0Z3TUNvd0JRWURL\
        MlZ3QXlFQQo4NWdLVzVKcWVzeUpzOXJpMzkvMEltbjlGS2dpUzZIaExpTk5UUXNHb0lFd0JRWURLMlZ3QTBFQVUxMm93cEUrCkQr\
        NWN5OHRPYmJIR1I5TkMxR3llZ2JLbkVIczEvNXlXT1VNVWtCVExScXJXZE9adC8vV25sSDd2QlQ4S1Jsb1UKU3k4aEd6Zm9aQUU3\
        Q1E9PQotLS0tLUVORCBDRVJUSUZJQ0FURS0tLS0tCg==";
}
