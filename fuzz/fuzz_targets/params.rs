#![no_main]

libfuzzer_sys::fuzz_target!(|input: oitlab_fuzz::params::Input| oitlab_fuzz::params::run(&input));
