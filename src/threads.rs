//! Where work runs: on the threads that all renders share, or on some of its own.

mod pools;

use crate::error::{Error, Result};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
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
    let pool = pools::take(threads);
    let pool = pool.map_err(|e| Error::argument("threads", format!("{threads} cannot be started: {e}")))?;
    let result = pool.install(|| work(threads));
    pools::give_back(pool);
    result
}

/// Whether this process has the shared threads: the fork of one that has used them has their memory alone, and would wait
/// for them forever.
fn have_shared() -> bool {
    static OWNER: OnceLock<u32> = OnceLock::new();
    let this = std::process::id();
    *OWNER.get_or_init(|| this) == this
}

/// Which thread other than the caller's does some work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum On {
    /// One of those that all renders share, if it may be.
    Shared,
    /// One of its own, for work that holds locks while it waits or has threads of its own.
    Own,
}

impl On {
    /// Where work on so many threads begins.
    pub fn threads(threads: Option<usize>) -> Self {
        if threads.is_none() { Self::Shared } else { Self::Own }
    }
}

/// Works that asked for a shared thread and have not ended, wherever they run.
static UNFINISHED: AtomicUsize = AtomicUsize::new(0);

/// One of them.
struct Unfinished;

impl Drop for Unfinished {
    fn drop(&mut self) {
        UNFINISHED.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Runs `work` on another thread than the caller's, then `done` with what came of it, or with its panic.
///
/// On a shared thread nothing has to be started, and what the work hands out in parts begins where it is. Only one that is alone
/// gets there: those threads may be taken by the parts of another for long, and while they wait for parts they would begin the
/// next work within the first, and so on. The others get threads of their own, as do those of a fork.
pub fn start<T: 'static>(
    on: On,
    work: impl FnOnce() -> T + Send + 'static,
    done: impl FnOnce(std::thread::Result<T>) + Send + 'static,
) {
    let caught = move || catch_unwind(AssertUnwindSafe(work));
    if on == On::Own {
        std::thread::spawn(move || done(caught()));
        return;
    }
    let alone = UNFINISHED.fetch_add(1, Ordering::AcqRel) == 0;
    let unfinished = Unfinished;
    let run = move || {
        let result = caught();
        drop(unfinished);
        done(result);
    };
    if alone && have_shared() && can_share() {
        rayon::spawn(run);
    } else {
        std::thread::spawn(run);
    }
}

/// Whether the shared threads could be started.
fn can_share() -> bool {
    static STARTED: OnceLock<bool> = OnceLock::new();
    *STARTED.get_or_init(|| catch_unwind(rayon::current_num_threads).is_ok())
}

/// Working memories that threads lend each other, no more than were ever needed at a time.
pub struct Workers<T, N> {
    /// Boxed, since they are handed from task to task.
    idle: Mutex<Vec<Box<T>>>,
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
    worker: Option<Box<T>>,
}

impl<T, N: Fn() -> T> Lent<'_, T, N> {
    /// The working memory, taken or made when it is first asked for.
    pub fn get(&mut self) -> &mut T {
        let Self { from, worker } = self;
        let idle = || from.idle.lock().map_or(None, |mut idle| idle.pop());
        worker.get_or_insert_with(|| idle().unwrap_or_else(|| Box::new((from.new)())))
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
    use std::sync::mpsc::channel;
    use std::time::Duration;

    #[test]
    fn works_that_wait_for_each_other_both_run() {
        let (results, all) = channel();
        let (first_says, first_said) = channel();
        let (second_says, second_said) = channel();
        let parts = || (0..100_u32).into_par_iter().sum::<u32>();
        let first = move || {
            first_says.send(()).unwrap();
            second_said.recv_timeout(Duration::from_secs(60)).map(|()| parts()).unwrap()
        };
        let done = results.clone();
        start(On::Shared, first, move |sum| done.send(sum.unwrap_or(0)).unwrap());
        let second = move || {
            first_said.recv_timeout(Duration::from_secs(60)).unwrap();
            second_says.send(()).unwrap();
            parts()
        };
        start(On::Shared, second, move |sum| results.send(sum.unwrap_or(0)).unwrap());
        assert_eq!(all.iter().collect::<Vec<_>>(), [4950, 4950]);
    }

    #[test]
    fn a_panic_is_handed_over_and_nothing_stays_behind() {
        for on in [On::Shared, On::Own, On::Shared] {
            let (says, said) = channel();
            start(
                on,
                || assert_eq!(1, 2, "meant to fail"),
                move |result| says.send(result.is_err()).unwrap(),
            );
            assert_eq!(said.recv_timeout(Duration::from_secs(60)), Ok(true), "{on:?}");
        }
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
