//! egp-service.
