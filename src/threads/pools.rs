//! Threads for calls that ask for a number of them, kept for the next such call: fresh ones take a tenth of a millisecond to start,
//! and the system may let them run on one core for some more before it moves them apart.

use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use std::sync::{Mutex, TryLockError};

/// Pools that are kept, at most. None has more threads than there are cores: somebody else may need them.
const POOLS: usize = 4;

/// A pool that nobody works on, with where its threads are: they may run where the thread that started them might, and a fork of
/// their process has but their memory.
struct Idle {
    process: u32,
    cores: Cores,
    pool: ThreadPool,
}

/// Which cores a thread may run on, where the system tells.
#[cfg(target_os = "linux")]
type Cores = Option<rustix::thread::CpuSet>;
#[cfg(not(target_os = "linux"))]
type Cores = ();

#[cfg(target_os = "linux")]
fn cores() -> Cores {
    rustix::thread::sched_getaffinity(None).ok()
}
#[cfg(not(target_os = "linux"))]
fn cores() -> Cores {}

/// The one that has been idle longest first.
static IDLE: Mutex<Vec<Idle>> = Mutex::new(Vec::new());

/// Changes what is idle, unless somebody else is at it: to a fork it may seem so forever.
fn change<T>(change: impl FnOnce(&mut Vec<Idle>) -> T) -> Option<T> {
    match IDLE.try_lock() {
        Ok(mut idle) => Some(change(&mut idle)),
        Err(TryLockError::Poisoned(poisoned)) => Some(change(&mut poisoned.into_inner())),
        Err(TryLockError::WouldBlock) => None,
    }
}

/// So many threads that nobody else works on, and that may run where the caller may.
///
/// # Errors
/// Where they cannot be started.
pub fn take(threads: usize) -> Result<ThreadPool, ThreadPoolBuildError> {
    let (this, cores) = (std::process::id(), cores());
    let fits = |idle: &Idle| {
        (idle.process, idle.cores) == (this, cores) && idle.pool.current_num_threads() == threads
    };
    let kept = change(|idle| idle.iter().rposition(fits).map(|place| idle.remove(place).pool));
    kept.flatten().map_or_else(|| ThreadPoolBuilder::new().num_threads(threads).build(), Ok)
}

/// Keeps them for later; the caller has to be who took them.
pub fn give_back(pool: ThreadPool) {
    if !may_keep(pool.current_num_threads()) {
        return;
    }
    let this = std::process::id();
    let keep = |idle: &mut Vec<Idle>| {
        idle.push(Idle { process: this, cores: cores(), pool });
        let others = idle.extract_if(.., |idle| idle.process != this);
        // what is dropped would be told to end, and there is nobody to tell it to
        others.for_each(std::mem::forget);
        (idle.len() > POOLS).then(|| idle.remove(0))
    };
    drop(change(keep));
}

fn may_keep(threads: usize) -> bool {
    std::thread::available_parallelism().is_ok_and(|cores| threads <= cores.get())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn threads_of(pool: &ThreadPool) -> Vec<std::thread::ThreadId> {
        pool.broadcast(|_| std::thread::current().id())
    }

    #[test]
    fn threads_are_used_again_but_by_one_at_a_time() {
        let (first, second) = (take(1).unwrap(), take(1).unwrap());
        assert_ne!(threads_of(&first), threads_of(&second));
        give_back(first);
        // other tests take pools of one thread, too
        let is_used_again = |_| {
            let pool = take(1).unwrap();
            let threads = threads_of(&pool);
            give_back(pool);
            let pool = take(1).unwrap();
            let again = threads_of(&pool) == threads;
            give_back(pool);
            again
        };
        assert!((0..1000).any(is_used_again));
        assert_ne!(threads_of(&take(1).unwrap()), threads_of(&second));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn threads_for_other_cores_are_others() {
        use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

        // on a thread of its own, whose cores are nobody else's business
        let on_one_core = std::thread::spawn(|| {
            let all = sched_getaffinity(None).unwrap();
            let mut one = CpuSet::new();
            one.set((0..CpuSet::MAX_CPU).find(|&core| all.is_set(core)).unwrap());
            for _ in 0..100 {
                give_back(take(1).unwrap());
            }
            sched_setaffinity(None, &one).unwrap();
            let pool = take(1).unwrap();
            let its = pool.install(|| sched_getaffinity(None).unwrap());
            give_back(pool);
            (its, one)
        });
        let (its, one) = on_one_core.join().unwrap();
        assert_eq!(its, one);
    }

    #[test]
    fn few_pools_are_kept_and_none_that_has_more_threads_than_cores() {
        let cores = std::thread::available_parallelism().unwrap().get();
        let pools: Vec<_> = [1, 1, 1, 1, 1, 1, cores, cores + 1].map(take).into_iter().collect();
        pools.into_iter().for_each(|pool| give_back(pool.unwrap()));
        let sizes = |idle: &mut Vec<Idle>| idle.iter().map(|idle| idle.pool.current_num_threads()).collect();
        let sizes: Vec<usize> = (0..1000).find_map(|_| change(sizes)).unwrap();
        assert!(sizes.len() <= POOLS && sizes.iter().all(|&threads| threads <= cores), "{sizes:?}");
    }
}
