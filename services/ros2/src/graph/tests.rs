use super::*;

const DETECTED: &str = "/perception/object_recognition/detection/objects";

fn endpoint(topic: &str, of: &str, is_publisher: bool) -> Endpoint {
    let dds = format!("autoware_perception_msgs::msg::dds_::{of}_");
    let endpoint = Endpoint::of_dds(&format!("rt{topic}"), &dds).unwrap();
    Endpoint { is_publisher, is_reliable: true, ..endpoint }
}

/// The bridge reads detections and publishes tracks.
fn graph(other: Endpoint) -> Graph {
    let mut graph = Graph::default();
    graph.own(endpoint(DETECTED, "DetectedObjects", false));
    graph.own(endpoint("/out", "TrackedObjects", true));
    graph.add([1; 16], other);
    graph.name([1; 16], "/detector");
    graph
}

fn near_misses(graph: &Graph) -> Vec<String> {
    graph.near_misses(&[DETECTED.to_owned()], 0, "127.0.0.1", &[])
}

#[test]
fn names_of_dds_are_names_of_ros() {
    let endpoint = endpoint("/a/b", "DetectedObjects", true);
    assert_eq!((endpoint.topic.as_str(), endpoint.short_type()), ("/a/b", "DetectedObjects"));
    assert_eq!(endpoint.of_type, "autoware_perception_msgs/msg/DetectedObjects");
    assert_eq!(Endpoint::of_dds("rq/service", "x"), None);
    assert_eq!(Endpoint::of_dds("ros_discovery_info", "x"), None);
}

#[test]
fn matched_endpoints_are_named_with_their_nodes() {
    let mut graph = graph(endpoint(DETECTED, "DetectedObjects", true));
    let expected = [
        (format!("reads {DETECTED} from"), "/detector".to_owned()),
        ("publishes /out to".to_owned(), "nobody".to_owned()),
    ];
    assert_eq!(graph.connections(), expected);
    assert!(near_misses(&graph).is_empty() && graph.is_matched(DETECTED));
    for id in [2, 3] {
        graph.add([id; 16], endpoint("/out", "TrackedObjects", false));
    }
    assert_eq!(graph.connections()[1].1, "a reader without a node (2 times)");
    graph.remove_participant([1; 12]);
    assert!(!graph.is_matched(DETECTED));
}

#[test]
fn near_misses_name_the_option_that_helps() {
    let reliable = endpoint(DETECTED, "DetectedObjects", true);
    let best_effort = Endpoint { is_reliable: false, ..reliable.clone() };
    let latched = Endpoint { is_latched: true, ..endpoint("/out", "TrackedObjects", false) };
    let rows = [
        (endpoint(DETECTED, "TrackedObjects", true), format!("set tracks = [\"{DETECTED}\"]")),
        (
            endpoint(DETECTED, "PredictedObjects", true),
            "not as autoware_perception_msgs/msg/Detected".to_owned(),
        ),
        (best_effort, "set best_effort = true".to_owned()),
        (
            endpoint("/car/objects", "DetectedObjects", true),
            format!("set remap = [\"{DETECTED}:=/car/objects\"]"),
        ),
        (latched, "transient local".to_owned()),
        (endpoint("/car/out", "TrackedObjects", false), "set remap = [\"/out:=/car/out\"]".to_owned()),
    ];
    for (other, expected) in rows {
        let found = near_misses(&graph(other.clone()));
        assert!(found[0].starts_with("/detector ") || found[1].starts_with("/detector "), "{found:?}");
        assert!(found.iter().any(|line| line.contains(&expected)), "{expected}: {found:?}");
    }
}

#[test]
fn endpoints_of_the_bridges_own_nodes_are_no_near_misses() {
    let mut graph = graph(endpoint("/car/objects", "DetectedObjects", true));
    graph.name([1; 16], "/stgdat/prediction");
    let expected = format!("nobody publishes {DETECTED} (DetectedObjects) in domain 0 on 127.0.0.1");
    assert_eq!(near_misses(&graph), [expected]);
}

#[test]
fn sockets_of_other_domains_are_found() {
    let sockets = "  sl  local_address rem_address\n 1: 00000000:1CE8 00000000:0000\n 2: 00000000:23BE 0:0\n";
    assert_eq!(domains(sockets, 0), [7]);
    assert_eq!(domains("4: 00000000:8D70 x\nnonsense\n5: 00000000:0035 x", 0), Vec::<u16>::new());
    let graph = Graph { own: vec![endpoint(DETECTED, "DetectedObjects", false)], ..Graph::default() };
    let line = &graph.near_misses(&[DETECTED.to_owned()], 0, "127.0.0.1", &[7])[0];
    assert!(line.contains("in domain 7: set domain = 7 or ROS_DOMAIN_ID"), "{line}");
    assert!(near_misses(&graph)[0].contains("`interfaces`"));
}
