#![no_main]

libfuzzer_sys::fuzz_target!(|text: &str| oitlab_fuzz::weights::run(text));
