//! Options of the stages: invalid values and help.

use nn::kernels::Isa;
use run::Run;
use testing::Scratch;

use crate::started::{assert_refused, run, run_well, stderr, stdout, stgdat};

#[test]
fn invalid_settings_are_refused_before_the_run() {
    let scratch = Scratch::new("refused");
    let recording = scratch.recording("scene.csv", 5);
    let cases: [(&str, &[&str]); 5] = [
        ("tracker.fov=90", &["--set tracker.fov=90", "expected WIDTH,RANGE"]),
        (
            "tracker.colour=red",
            &[
                "the tracker has no option `colour`",
                "associate, association, cyclist_speed_max_mps, fov, frozen_frames",
            ],
        ),
        ("sampler.particles=0", &["`particles` is out of range", "1 to 32"]),
        ("radar.fov=90,80", &["there is no stage \"radar\"", "tracker"]),
        ("fov", &["expected STAGE.OPTION=VALUE"]),
    ];
    for (set, texts) in cases {
        for verb in [&["run"][..], &["predict", &recording], &["track", &recording], &["bench"]] {
            assert_refused(&[verb, &["--set", set]].concat(), 2, texts);
        }
    }
    assert_refused(&["predict", &recording, "--set", "recorder.report=a"], 2, &["there is no recorder here"]);
    assert_refused(&["bench", "--set", "source.agents=3"], 2, &["there is no source here"]);
    assert_refused(&["predict", &recording, "--set", "source.recording=a"], 2, &["already an argument"]);
    let pipeline = scratch.pipeline("p.toml", "budget_ms = 6", "budget_ms = 6\noptions = { fov = \"wide\" }");
    assert_refused(
        &["check", &pipeline],
        78,
        &["`fov` of the tracker", "p.toml:25:", "expected WIDTH,RANGE"],
    );
}

#[test]
fn a_precision_that_the_kernels_lack_is_refused() {
    let scratch = Scratch::new("precision");
    let recording = scratch.recording("scene.csv", 5);
    let set = ["--set", "decoder.precision=bf16", "--kernels", "portable"];
    let message = "--set decoder.precision=bf16: precision bf16 needs ";
    for verb in [&["run"][..], &["predict", &recording], &["bench"]] {
        assert_refused(&[verb, &set].concat(), 78, &[message, "leave the precision at f32"]);
    }
    let decoder = "name = \"decoder\"";
    let options = format!("{decoder}\noptions = {{ precision = \"bf16\" }}");
    let pipeline = scratch.pipeline("bf16.toml", decoder, &options);
    assert_refused(
        &["run", "--pipeline", &pipeline, "--kernels", "portable"],
        78,
        &["precision of the decoder: precision bf16 needs "],
    );
    assert_refused(&["run", "--set", "decoder.precision=f16"], 2, &["expected f32 or bf16"]);
}

#[test]
fn an_instruction_set_that_the_processor_lacks_is_refused() {
    let lacking = if Isa::Neon.available() { Isa::Avx2 } else { Isa::Neon };
    let message = format!("this processor has no {lacking}, only ");
    assert_refused(&["verify", "golden", "--kernels", lacking.key()], 2, &[&message, "portable"]);
    assert_refused(&["run", "--kernels", "sse"], 2, &["'sse'", "avx512, avx2, neon, portable"]);
    let by_variable = stgdat().arg("doctor").env("STGDAT_KERNELS", lacking.key()).output().unwrap();
    assert_eq!(by_variable.status.code(), Some(2), "{}", stderr(&by_variable));
    let portable = stgdat().arg("--version").env("STGDAT_KERNELS", "portable").output().unwrap();
    assert!(stdout(&portable).contains("kernels portable"), "{}", stdout(&portable));
    let told = stdout(&run(&["doctor", "--kernels", "portable"]));
    assert!(told.contains("portable (as --kernels or STGDAT_KERNELS says; this CPU has "), "{told}");
}

#[test]
fn help_lists_the_options_of_the_stages() {
    for arguments in [&["stage", "--help"][..], &["stage", "tracker", "--help"]] {
        let help = stdout(&run_well(arguments));
        for texts in [
            "tracker.fov (text): WIDTH,RANGE, up to 360 degrees and 1000 m",
            "sampler.deadline_ms (number): more than 0 and at most 80 [default: 72.0]",
            "Number of threads for the work of a tick",
        ] {
            assert!(help.contains(texts), "{help}");
        }
    }
}

#[test]
fn a_stage_refuses_weights_of_another_model() {
    let scratch = Scratch::new("other-model");
    let record = scratch.path("run");
    // The stages end before they join the run.
    let of_run = Run { root: scratch.path("").into(), ..Run::default() };
    of_run.write(record.as_ref()).expect("the scratch folder can be written to");
    let mut model = nn::Weights::onboard().config().clone();
    for stage in ["tracker", "localiser", "encoder", "sampler"] {
        assert_refused(&["stage", stage, "--run", &record], 78, &["model.json: No such file"]);
    }
    model.edge_radius_m += 1.0;
    model.write(of_run.root.as_path()).expect("the scratch folder can be written to");
    let texts = "the weights are of another model than the run's: edge_radius_m is ";
    for stage in ["extractor", "encoder", "decoder"] {
        assert_refused(&["stage", stage, "--run", &record], 65, &[texts]);
    }
}
