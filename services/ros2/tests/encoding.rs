//! The messages have the same bytes whether serde or this project's own CDR writes them.

use interop::cdr::{Cdr, from_bytes};
use interop::messages::{
    DetectedObjects, DiagnosticArray, MarkerArray, PredictedObjects, TfMessage, TrackedObjects,
};
use rustdds::no_key::{DeserializerAdapter as _, SerializerAdapter as _};
use rustdds::serialization::{CDRDeserializerAdapter, CDRSerializerAdapter};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Reads Cyclone's bytes of a message, and compares what DDS would send and what it reads.
fn same<M: Cdr + Clone + PartialEq + std::fmt::Debug + Serialize + DeserializeOwned>(bytes: &[u8]) {
    let message: M = from_bytes(bytes).expect("Cyclone's bytes");
    let sent = CDRSerializerAdapter::<M>::to_bytes(&message).expect("a message");
    assert!(sent[..] == bytes[4..], "other bytes than Cyclone's");
    let encoding = CDRSerializerAdapter::<M>::output_encoding();
    assert_eq!(CDRDeserializerAdapter::<M>::from_bytes(&bytes[4..], encoding).expect("a message"), message);
}

#[test]
fn dds_sends_and_reads_the_bytes_of_cyclone() {
    same::<DetectedObjects>(include_bytes!("../../../shared/interop/src/golden/DetectedObjects.cdr"));
    same::<TrackedObjects>(include_bytes!("../../../shared/interop/src/golden/TrackedObjects.cdr"));
    same::<PredictedObjects>(include_bytes!("../../../shared/interop/src/golden/PredictedObjects.cdr"));
    same::<TfMessage>(include_bytes!("../../../shared/interop/src/golden/TFMessage.cdr"));
    same::<MarkerArray>(include_bytes!("../../../shared/interop/src/golden/MarkerArray.cdr"));
    same::<DiagnosticArray>(include_bytes!("../../../shared/interop/src/golden/DiagnosticArray.cdr"));
}
