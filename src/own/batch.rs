//! Few calls for many pixels: techniques ask for a pixel's weights, and a callback's call costs as much as thousands of
//! them.
//!
//! The work is run twice. The first time what is asked for is noted, and answered with ones; then all of it is computed
//! at once; the second time the answers are handed out in the same order. That is right for any work whose questions do
//! not depend on the answers, as depths and coverages do not depend on weights.

use super::{CALL, Callback};
use std::cell::RefCell;

/// Runs `work` so that callbacks are asked for everything in it at once.
pub fn in_batches(mut work: impl FnMut()) {
    Recorder::swap(Some(Recorder { replaying: false, notes: Vec::new() }));
    work();
    let Some(mut recorder) = Recorder::swap(None) else { return };
    recorder.notes.iter_mut().for_each(Note::answer);
    recorder.replaying = true;
    Recorder::swap(Some(recorder));
    work();
    Recorder::swap(None);
}

thread_local! {
    static RECORDER: RefCell<Option<Recorder>> = const { RefCell::new(None) };
}

/// What this thread asks callbacks for.
pub struct Recorder {
    replaying: bool,
    notes: Vec<Note>,
}

/// What one callback is asked for.
struct Note {
    function: Callback,
    inputs: Vec<Vec<f32>>,
    answers: Vec<f32>,
    handed_out: usize,
}

impl Recorder {
    fn swap(new: Option<Self>) -> Option<Self> {
        RECORDER.with(|recorder| std::mem::replace(&mut *recorder.borrow_mut(), new))
    }

    /// Calls the function, or has it called later. Whether `results` are its own.
    pub fn evaluate(function: &Callback, inputs: &[&[f32]], results: &mut [f32]) -> bool {
        let answered = RECORDER.with(|recorder| match &mut *recorder.borrow_mut() {
            None => None,
            Some(recorder) => recorder.answer(function, inputs, results),
        });
        answered.unwrap_or_else(|| {
            call(function, inputs, results);
            true
        })
    }

    /// Notes what is asked for, or hands it out; none where it was not asked for the first time.
    fn answer(&mut self, function: &Callback, inputs: &[&[f32]], results: &mut [f32]) -> Option<bool> {
        let same = |note: &Note| note.function == *function && note.inputs.len() == inputs.len();
        let place = self.notes.iter().position(same);
        if self.replaying {
            let note = &mut self.notes[place?];
            let end = note.handed_out + results.len();
            results.copy_from_slice(note.answers.get(note.handed_out..end)?);
            note.handed_out = end;
            return Some(true);
        }
        let place = place.unwrap_or_else(|| {
            let inputs = vec![Vec::new(); inputs.len()];
            self.notes.push(Note { function: function.clone(), inputs, answers: Vec::new(), handed_out: 0 });
            self.notes.len() - 1
        });
        for (all, more) in self.notes[place].inputs.iter_mut().zip(inputs) {
            all.extend_from_slice(more);
        }
        results.fill(1.0);
        Some(false)
    }
}

impl Note {
    fn answer(&mut self) {
        self.answers.resize(self.inputs.first().map_or(0, Vec::len), 0.0);
        let inputs: Vec<_> = self.inputs.iter().map(Vec::as_slice).collect();
        call(&self.function, &inputs, &mut self.answers);
    }
}

/// Calls a function for a few thousand values at a time.
fn call(function: &Callback, inputs: &[&[f32]], results: &mut [f32]) {
    let mut first = 0;
    for results in results.chunks_mut(CALL) {
        let inputs: Vec<_> = inputs.iter().map(|input| &input[first..first + results.len()]).collect();
        function.0.call(&inputs, results);
        first += results.len();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::own::ArrayFunction;
    use std::any::Any;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// x + 1, and how often that was asked for.
    #[derive(Default)]
    struct PlusOne(AtomicUsize);

    impl ArrayFunction for PlusOne {
        fn call(&self, inputs: &[&[f32]], results: &mut [f32]) {
            self.0.fetch_add(1, Ordering::Relaxed);
            results.iter_mut().zip(inputs[0]).for_each(|(result, x)| *result = x + 1.0);
        }
        fn id(&self) -> usize {
            std::ptr::from_ref(self).addr()
        }
        fn describe(&self) -> String {
            "x + 1".into()
        }
        fn as_any(&self) -> &dyn Any {
            self
        }
    }

    #[test]
    fn many_questions_become_one_call() {
        let function = Arc::new(PlusOne::default());
        let callback = Callback(function.clone());
        let mut found = Vec::new();
        in_batches(|| {
            found.clear();
            for i in 0..100_u8 {
                let mut results = [0.0; 3];
                let x = f32::from(i);
                let known = Recorder::evaluate(&callback, &[&[x, x + 0.25, x + 0.5]], &mut results);
                found.extend(results.map(|result| (known, result)));
            }
        });
        assert_eq!(function.0.load(Ordering::Relaxed), 1);
        assert_eq!(found[3 * 99 + 1], (true, 100.25));
        assert!(found.iter().all(|(known, _)| *known));
        let mut result = [0.0];
        assert!(Recorder::evaluate(&callback, &[&[2.0]], &mut result));
        assert_eq!(result, [3.0]);
    }

    #[test]
    fn long_arrays_are_handed_over_in_parts() {
        let function = Arc::new(PlusOne::default());
        let mut results = vec![0.0; 2 * CALL + 1];
        call(&Callback(function.clone()), &[&vec![1.0; 2 * CALL + 1]], &mut results);
        assert_eq!(function.0.load(Ordering::Relaxed), 3);
        assert!(results.iter().all(|&x| x == 2.0));
    }
}
