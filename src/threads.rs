//! Where work runs: on the threads that all renders share, or on some of its own.

use crate::error::{Error, Result};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, OnceLock};

/// Runs `work` on so many threads, or on those that all renders share, telling it how many they are.
///
/// # Errors
/// Those of `work`; [`Error::Argument`] where so many threads cannot be started.
pub fn with_threads<T: Send>(
    threads: Option<usize>,
    work: impl FnOnce(usize) -> Result<T> + Send,
) -> Result<T> {
    let threads = match threads {
        Some(0) => return Err(Error::argument("threads", "0 is not a number >= 1, or None for all cores")),
        None if have_shared() => return work(rayon::current_num_threads()),
        // as many for itself
        None => rayon::current_num_threads(),
        Some(n) => n,
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|e| Error::argument("threads", format!("{threads} cannot be started: {e}")))?;
    pool.install(|| work(threads))
}

/// Whether this process has the shared threads: the fork of one that has used them has their memory alone, and would wait
/// for them forever.
fn have_shared() -> bool {
    static OWNER: OnceLock<u32> = OnceLock::new();
    let this = std::process::id();
    *OWNER.get_or_init(|| this) == this
}

/// Runs `work` on another thread than the caller's, then `done` with what came of it.
///
/// That is one of the shared threads, where none of them has such work yet: nothing has to be started, and what the work
/// hands out in parts begins where it is. A second work would be begun by threads that wait for parts of the first,
/// within it, and so on; it gets a thread of its own.
pub fn start<T>(work: impl FnOnce() -> T + Send + 'static, done: impl FnOnce(T) + Send + 'static) {
    static BUSY: AtomicBool = AtomicBool::new(false);
    if !have_shared() || BUSY.swap(true, Ordering::Acquire) {
        std::thread::spawn(move || done(work()));
        return;
    }
    rayon::spawn(move || {
        let result = work();
        BUSY.store(false, Ordering::Release);
        done(result);
    });
}

/// Working memories that threads lend each other, no more than were ever needed at a time.
pub struct Workers<T, N> {
    idle: Mutex<Vec<T>>,
    new: N,
}

impl<T, N: Fn() -> T> Workers<T, N> {
    /// None yet; `new` makes one.
    pub fn new(new: N) -> Self {
        Self { idle: Mutex::new(Vec::new()), new }
    }

    /// One of them for a run of tasks, such as rayon's `map_init` hands out: one lock for all of them.
    pub fn lend(&self) -> Lent<'_, T, N> {
        Lent { from: self, worker: None }
    }
}

/// A working memory that goes back when it is dropped.
pub struct Lent<'a, T, N> {
    from: &'a Workers<T, N>,
    worker: Option<T>,
}

impl<T, N: Fn() -> T> Lent<'_, T, N> {
    /// The working memory, taken or made when it is first asked for.
    pub fn get(&mut self) -> &mut T {
        let Self { from, worker } = self;
        let idle = || from.idle.lock().map_or(None, |mut idle| idle.pop());
        worker.get_or_insert_with(|| idle().unwrap_or_else(&from.new))
    }
}

impl<T, N> Drop for Lent<'_, T, N> {
    fn drop(&mut self) {
        if let (Some(worker), Ok(mut idle)) = (self.worker.take(), self.from.idle.lock()) {
            idle.push(worker);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;
    use std::sync::atomic::AtomicUsize;
    use std::sync::mpsc::channel;
    use std::time::Duration;

    #[test]
    fn works_that_wait_for_each_other_both_run() {
        let (results, all) = channel();
        let (first_says, first_said) = channel();
        let (second_says, second_said) = channel();
        let parts = || (0..100_u32).into_par_iter().sum::<u32>();
        let done = results.clone();
        let first = move || {
            first_says.send(()).unwrap();
            second_said.recv_timeout(Duration::from_secs(60)).map(|()| parts()).unwrap()
        };
        start(first, move |sum| done.send(sum).unwrap());
        let second = move || {
            first_said.recv_timeout(Duration::from_secs(60)).unwrap();
            second_says.send(()).unwrap();
            parts()
        };
        start(second, move |sum| results.send(sum).unwrap());
        assert_eq!(all.iter().collect::<Vec<_>>(), [4950, 4950]);
    }

    #[test]
    fn work_is_told_its_threads_and_none_are_refused() {
        assert_eq!(with_threads(Some(3), Ok).unwrap(), 3);
        assert_eq!(with_threads(None, Ok).unwrap(), rayon::current_num_threads());
        let refused = with_threads(Some(0), Ok).unwrap_err().to_string();
        assert!(refused.contains("threads") && refused.contains("0 is not"), "{refused}");
    }

    #[test]
    fn working_memories_go_back_and_are_made_only_where_they_are_used() {
        let made = AtomicUsize::new(0);
        let workers = Workers::new(|| made.fetch_add(1, Ordering::Relaxed));
        drop(workers.lend());
        assert_eq!(made.load(Ordering::Relaxed), 0);
        let (mut a, mut b) = (workers.lend(), workers.lend());
        assert_eq!([*a.get(), *b.get(), *a.get()], [0, 1, 0]);
        drop((a, b));
        let numbers: Vec<usize> =
            (0..100).into_par_iter().map_init(|| workers.lend(), |lent, _| *lent.get()).collect();
        assert_eq!(numbers.len(), 100);
        assert!(made.load(Ordering::Relaxed) <= 2 + rayon::current_num_threads());
    }
}
