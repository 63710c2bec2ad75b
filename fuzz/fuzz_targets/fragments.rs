#![no_main]

libfuzzer_sys::fuzz_target!(|input: oitlab_fuzz::fragments::Input| oitlab_fuzz::fragments::run(&input));
