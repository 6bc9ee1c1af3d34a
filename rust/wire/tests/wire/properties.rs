//! Decoding does not panic on any bytes, and a decoded message encodes to itself.

use egp_testing::messages;
use egp_wire::{Header, Predictions, Ready, Reply, Request, WireError, proto};
use proptest::{collection::vec, prelude::*};
use prost::Message as _;

fn row<const W: usize>(limit: f64) -> impl Strategy<Value = [f64; W]> {
    [(); W].map(|()| -limit..limit)
}

prop_compose! {
    fn request()(horizon in 1usize..30, members in 1usize..9, history in 0usize..12)(
        x in row(1.5), u_prev in row(10.0), raw_weights in vec(0.01..1.0, members),
        plan_x in vec(row(1.5), horizon + 1), plan_u in vec(row(10.0), horizon),
        plan_shift in 0..=u32::try_from(horizon).unwrap(),
        history_z in vec(row(1.0), history), history_y in vec(row(1.0), history),
        mut history_f in vec(row(1e7), members * history), predicted in 0..=history,
        reference in vec(row(1e4), horizon + 1).prop_map(|rows| rows.iter().map(|r: &[f64; 4]| [r[0], r[1], r[2] / 1e3, r[3]]).collect()),
        widths in vec([0.0..50.0, 0.0..50.0], horizon + 1),
        road_friction in vec([0.01..3.0, 0.0..3.0], horizon + 2),
        sequence in any::<u64>(), budget_us in 1u32..10_000_000, want_sigma in any::<bool>(),
        library in any::<[u8; 32]>(),
    ) -> Request {
        let sum: f64 = raw_weights.iter().sum();
        let weights = raw_weights.iter().map(|w| w / sum).collect();
        history_f.truncate(predicted * raw_weights.len());
        let history_f = Predictions::new(raw_weights.len(), history_f);
        Request {
            library, sequence, budget_us, x, u_prev, weights, plan_x, plan_u, plan_shift,
            history_z, history_y, history_f, reference, widths, want_sigma, road_friction,
        }
    }
}

proptest! {
    #[test]
    fn requests_round_trip(request in request()) {
        let decoded = Request::decode(&request.encode()).unwrap();
        prop_assert_eq!(&decoded, &request);
        let header = Header::decode(&request.encode()).unwrap();
        prop_assert_eq!(header.sequence, request.sequence);
    }

    #[test]
    fn requests_are_written_as_prost_writes_them(request in request()) {
        let bytes = request.encode();
        let raw = proto::StepRequest::decode(&*bytes).unwrap();
        prop_assert_eq!(raw.encode_to_vec(), bytes);
    }

    #[test]
    fn memory_of_a_former_request_leaves_no_trace(first in request(), second in request()) {
        let mut memory = Request::decode(&first.encode()).unwrap();
        memory.decode_from(&second.encode()).unwrap();
        prop_assert_eq!(memory, second);
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes in vec(any::<u8>(), 0..600)) {
        let _ = Request::decode(&bytes);
        let _ = Reply::decode(&bytes);
        let _ = Ready::decode(&bytes);
        let _ = Header::decode(&bytes);
        let _ = WireError::decode(&bytes);
    }

    #[test]
    fn damaged_messages_never_panic(at in 0usize..2000, bit in 0u8..8) {
        for (_, mut bytes) in messages::all() {
            let at = at % bytes.len();
            bytes[at] ^= 1 << bit;
            if let Ok(request) = Request::decode(&bytes) {
                prop_assert!(request.validate().is_ok());
                // prost reads the same message from the same bytes.
                let raw = proto::StepRequest::decode(&*bytes).unwrap().encode_to_vec();
                prop_assert_eq!(Request::decode(&raw).unwrap(), request);
            }
            if let Ok(reply) = Reply::decode(&bytes) {
                let raw = proto::StepReply::decode(&*bytes).unwrap().encode_to_vec();
                prop_assert_eq!(format!("{:?}", Reply::decode(&raw).unwrap()), format!("{reply:?}"));
            }
        }
    }
}
