//! Weights files: complete, in half precision, truncated, damaged, or in another format.

use nn::{
    ContextCnn, ContextMemory, EncodingFunction, MlpMemory, StateMlp, Stored, Weights, WeightsError, encode,
};
use proptest::prelude::*;
use safetensors::Dtype;
use testing::{Model, value};

#[test]
fn the_embedded_weights_hold_the_whole_model() {
    let weights = Weights::onboard();
    weights.check().unwrap();
    assert_eq!(weights.sha256().len(), 64);
}

#[test]
fn written_weights_are_read_again() {
    let weights = Weights::onboard();
    let read = |weights: &Weights, name: &str, shape: &[usize]| weights.tensor(name, shape).unwrap().to_vec();
    let values: Vec<_> =
        weights.shapes().map(|(name, shape)| (name, shape, read(&weights, name, shape))).collect();
    let config = serde_json::to_string(weights.config()).unwrap();
    for stored in [Stored::F16, Stored::F32] {
        let tensors = values.iter().map(|(name, shape, values)| (*name, *shape, &values[..]));
        let bytes = encode(tensors, stored, [("config".to_owned(), config.clone())].into()).unwrap();
        let again = Weights::from_bytes(&bytes).unwrap();
        again.check().unwrap();
        assert_eq!(again.config(), weights.config());
        assert!(values.iter().all(|(name, shape, values)| read(&again, name, shape) == *values));
    }
    let short = encode([("a", &[3][..], &[1.0][..])], Stored::F32, [].into());
    assert!(short.is_err());
}

#[test]
fn every_option_has_its_tensors() {
    let model = Model::with_all_options();
    model.weights().check().unwrap();
    for name in [
        "decoder.cyclist.latents",
        "decoder.cyclist.latent_base.weight",
        "decoder.vehicle.mode.0.bias",
        "base.pedestrian.anchors",
    ] {
        let mut lacking = Model::with_all_options();
        lacking.tensors.retain(|(known, ..)| known != name);
        let error = lacking.weights().check().unwrap_err();
        assert!(matches!(&error, WeightsError::Missing { name: missing } if missing == name), "{error}");
    }
}

#[test]
fn types_without_networks_of_their_own_take_the_pedestrians() {
    let mut model = Model::with_all_options();
    model.config["node_types"] = "same".into();
    let of_others = |name: &str| {
        (name.starts_with("fe.state.") || name.starts_with("decoder.")) && !name.contains(".pedestrian.")
    };
    model.tensors.retain(|(name, ..)| !of_others(name));
    let weights = model.weights();
    weights.check().unwrap();
    let mlp = StateMlp::new(&weights).unwrap();
    let embed = |agent_type| {
        let mut out = vec![0.0; weights.config().state_embedding_len()];
        mlp.embed(agent_type, &[[0.3; 6]], &mut MlpMemory::default(), &mut out);
        out
    };
    assert_eq!(embed(wire::AgentType::Vehicle), embed(wire::AgentType::Pedestrian));
}

#[test]
fn half_precision_changes_embeddings_by_its_rounding_alone() {
    let mut model = Model::onboard();
    model.set("fe.context.fc.weight", &[32, 128]);
    let halved = Weights::from_bytes(&model.bytes(Dtype::F16)).unwrap();
    let embed = |weights: &Weights| {
        let cnn = ContextCnn::new(weights).unwrap();
        let patch: Vec<f32> = (0..cnn.patch_len()).map(value).collect();
        let mut out = [[0.0; 32]];
        cnn.embed(&patch, &mut ContextMemory::default(), &mut out);
        out[0]
    };
    let (full, half) = (embed(&model.weights()), embed(&halved));
    let largest = full.iter().fold(0.0_f32, |most, x| most.max(x.abs()));
    assert_ne!(full, half);
    assert!(full.iter().zip(&half).all(|(a, b)| (a - b).abs() < 0.02 * largest), "{full:?} and {half:?}");
}

#[test]
fn truncated_files_and_other_formats_have_errors_of_their_own() {
    let bytes = Model::onboard().bytes(Dtype::F32);
    for len in [0, 7, 8, 100, 9_000, bytes.len() / 2, bytes.len() - 1] {
        let error = Weights::from_bytes(&bytes[..len]).unwrap_err();
        assert!(matches!(error, WeightsError::Truncated { found, .. } if found == len), "{len}: {error}");
    }
    for other in
        ["PK\u{3}\u{4} a zip archive of weights", "{\"a\": 1, \"json\": \"file\", \"of\": \"weights\"}"]
    {
        let error = Weights::from_bytes(other.as_bytes()).unwrap_err();
        assert!(matches!(error, WeightsError::NotSafetensors(_)), "{error}");
    }
    let error = Weights::open(std::path::Path::new("no/such/file")).unwrap_err();
    assert!(matches!(error, WeightsError::Unreadable { .. }) && error.to_string().contains("no/such/file"));
}

#[test]
fn errors_name_the_tensor_and_both_shapes() {
    let mut model = Model::onboard();
    model.set("fe.relation.1.weight", &[128, 64]);
    let error = model.weights().check().unwrap_err().to_string();
    assert_eq!(error, "tensor fe.relation.1.weight has shape [128, 64], the model needs [128, 128]");

    let mut model = Model::onboard();
    model.tensors.retain(|(name, ..)| name != "gdat.temporal.score.weight");
    let error = model.weights().check().unwrap_err().to_string();
    assert_eq!(error, "tensor gdat.temporal.score.weight is missing");

    let mut model = Model::onboard();
    let (name, _, values) = &mut model.tensors[5];
    values[3] = f32::NAN;
    let expected = format!("tensor {name}: value 3 is NaN");
    let error = Weights::from_bytes(&model.bytes(Dtype::F32)).unwrap_err().to_string();
    assert_eq!(error, expected);

    let error = Weights::from_bytes(&Model::onboard().bytes(Dtype::I32)).unwrap_err().to_string();
    assert!(error.ends_with("holds I32, expected F32 or F16"), "{error}");
}

#[test]
fn strange_configurations_are_refused() {
    let refuse = |key: &str, value: serde_json::Value| {
        let mut model = Model::onboard();
        model.config[key] = value;
        Weights::from_bytes(&model.bytes(Dtype::F32)).unwrap_err().to_string()
    };
    assert!(refuse("depth", 3.into()).contains("unknown field `depth`"));
    assert!(refuse("stem", "resnet".into()).contains("unknown variant `resnet`"));
    assert!(refuse("topological_heads", 5.into()).contains("topological_heads = 5: does not divide 64"));
    assert!(refuse("dt_s", (-0.4).into()).contains("dt_s = -0.4"));
    assert!(refuse("rounds", 9.into()).contains("rounds = 9: is out of range"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn no_damage_to_the_header_panics(at in 0_usize..12_000, byte: u8) {
        let mut bytes = BYTES.with(Clone::clone);
        bytes[at] = byte;
        if let Ok(weights) = Weights::from_bytes(&bytes) {
            let _ = weights.check();
            let _ = EncodingFunction::new(&weights);
        }
    }
}

thread_local! {
    static BYTES: Vec<u8> = Model::onboard().bytes(Dtype::F32);
}
