#![no_main]

libfuzzer_sys::fuzz_target!(|input: oitlab_fuzz::scenes::Input| oitlab_fuzz::scenes::run(&input));
