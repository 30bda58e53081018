//! Checks of free space in shared memory and on the disk, and of stale domains.

use std::path::Path;

use rustix::fs::statvfs;

use super::{Check, bytes};
use crate::channel::{ChannelError, DomainOwner, StaleDomain, check_shared_memory};
use crate::log::bytes_per_tick;

/// The folder of iceoryx2's shared memory.
const SHM: &str = "/dev/shm";
/// Below this, only few runs fit at the same time.
const SHM_PLENTY: u64 = 16 << 20;
/// The space that `tectum run` leaves free, and a short log.
const DISK_NEEDED: u64 = 32 << 20;
/// Below this, the log of a long run may not fit.
const DISK_PLENTY: u64 = 1 << 30;
/// Ticks in an hour at 50 ms.
const TICKS_PER_HOUR: f64 = 72_000.0;

/// Checks shared memory, and the disk of `folder`.
pub(super) fn free_space(folder: &Path) -> [Check; 2] {
    let space = |path: &Path| statvfs(path).ok().map(|fs| (fs.f_blocks * fs.f_frsize, fs.f_bavail * fs.f_frsize));
    [shared_memory(check_shared_memory(), space(Path::new(SHM)).unwrap_or_default()), disk(space(folder))]
}

/// `usable` is what a run would meet; `size` and `free` are bytes.
fn shared_memory(usable: Result<(), ChannelError>, (size, free): (u64, u64)) -> Check {
    let name = "shared memory";
    match usable {
        Err(ChannelError::SharedMemory { found, remedy }) => Check::problem(name, found, remedy),
        _ if free < SHM_PLENTY => Check::better(
            name,
            format!("/dev/shm has {} of {} free", bytes(free), bytes(size)),
            "`sudo mount -o remount,size=256M /dev/shm`, in Docker `--shm-size=256m`; `tectum doctor --clean` \
             frees what runs have left",
        ),
        _ => Check::fine(name, format!("/dev/shm has {} of {} free", bytes(free), bytes(size))),
    }
}

/// Checks whether systemd-logind removes this user's shared memory when the user logs out, which takes away that of
/// a run that goes on.
pub(super) fn removal_at_logout() -> Check {
    let own = rustix::process::getuid().as_raw();
    let user = std::fs::read_to_string("/etc/passwd").unwrap_or_default();
    let user = user.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(own)).then(|| name.to_owned())
    });
    let lingers = user.is_some_and(|user| Path::new("/var/lib/systemd/linger").join(user).exists());
    let running = Path::new("/run/systemd/seats").exists();
    let mut settings = std::fs::read_to_string("/etc/systemd/logind.conf").unwrap_or_default();
    let mut more: Vec<_> = ["/usr/lib/systemd/logind.conf.d", "/etc/systemd/logind.conf.d"]
        .iter()
        .flat_map(std::fs::read_dir)
        .flat_map(|entries| entries.flatten().map(|entry| entry.path()))
        .collect();
    more.sort_by_key(|path| path.file_name().map(ToOwned::to_owned));
    more.iter().for_each(|path| settings += &("\n".to_owned() + &std::fs::read_to_string(path).unwrap_or_default()));
    logout(running, own, lingers, &settings)
}

/// The verdict, from whether logind runs, the user's id, whether the user lingers, and logind's settings.
fn logout(running: bool, user: u32, lingers: bool, settings: &str) -> Check {
    let name = "memory at logout";
    let set = settings.lines().filter_map(|line| line.trim().strip_prefix("RemoveIPC=")).next_back();
    let removes = !set.is_some_and(|value| ["no", "false", "off", "0"].contains(&value.trim().to_lowercase().as_str()));
    // Of system users, logind removes nothing.
    if running && removes && user >= 1000 && !lingers {
        let remedy = "`loginctl enable-linger`, or RemoveIPC=no in /etc/systemd/logind.conf: otherwise a run that goes \
                      on without a terminal loses its memory";
        Check::better(name, "systemd-logind removes this user's shared memory at the last logout (RemoveIPC)", remedy)
    } else {
        Check::fine(name, "kept")
    }
}

fn disk(space: Option<(u64, u64)>) -> Check {
    let name = "disk";
    let Some((_, free)) = space else { return Check::fine(name, "not told") };
    let hour = bytes((bytes_per_tick(1) * TICKS_PER_HOUR) as u64);
    let found = format!("{} free here; an hour of ticks of 50 ms logs {hour}", bytes(free));
    let remedy = "choose another disk with --out, or thin the log with `[log] every`";
    match free {
        free if free < DISK_NEEDED => Check::problem(name, found, remedy),
        free if free < DISK_PLENTY => Check::better(name, found, remedy),
        _ => Check::fine(name, found),
    }
}

/// Checks for domains that runs have left in shared memory.
pub(super) fn debris(domains: &[StaleDomain], removed: &[StaleDomain]) -> Check {
    let (mut parts, mut remedies) = (Vec::new(), Vec::new());
    if !removed.is_empty() {
        parts.push(format!("removed {}", removed.iter().map(describe).collect::<Vec<_>>().join(", ")));
    }
    let left: Vec<_> = domains.iter().filter(|d| d.owner == DomainOwner::Nobody).map(describe).collect();
    if !left.is_empty() {
        parts.push(format!("left behind: {}", left.join(", ")));
        remedies.push("`tectum doctor --clean` removes it, and so does the next run".to_owned());
    }
    for stale_domain in domains {
        if let DomainOwner::Processes { pids } = &stale_domain.owner {
            let pids: Vec<_> = pids.iter().map(u32::to_string).collect();
            let pids = pids.join(", ");
            parts.push(format!("{} has no launcher any more and is used by process {pids}", stale_domain.domain));
            remedies
                .push(format!("processes end within a second of their launcher; end those that do not: kill {pids}"));
        }
    }
    parts.extend(count_owned(domains));
    let found = if parts.is_empty() { "nothing left".to_owned() } else { parts.join("; ") };
    if remedies.is_empty() {
        Check::fine("debris of runs", found)
    } else {
        Check::better("debris of runs", found, remedies.join("; "))
    }
}

/// Name and size of a domain.
fn describe(domain: &StaleDomain) -> String {
    format!("{} ({} files, {})", domain.domain, domain.files, bytes(domain.bytes))
}

/// How many domains have an owner that is alive or unknown, by kind of owner.
fn count_owned(domains: &[StaleDomain]) -> Vec<String> {
    let count = |is_kind: fn(&DomainOwner) -> bool| domains.iter().filter(|d| is_kind(&d.owner)).count();
    let counts = [
        (count(|o| matches!(o, DomainOwner::Launcher { .. } | DomainOwner::Young)), "of living runs"),
        (count(|o| matches!(o, DomainOwner::OtherVersion { .. })), "of living runs of another version"),
        (count(|o| *o == DomainOwner::OtherUser), "of other users"),
    ];
    counts.iter().filter(|(count, _)| *count > 0).map(|(count, owners)| format!("{count} {owners}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Verdict::{CouldBeBetter, Fine, Problem};

    #[test]
    fn too_little_space_is_reported() {
        let refused = || ChannelError::SharedMemory { found: "it is read-only".into(), remedy: "mount it" };
        for (usable, space, verdict) in [
            (Err(refused()), (1 << 30, 1 << 30), Problem),
            (Ok(()), (64 << 20, 8 << 20), CouldBeBetter),
            (Ok(()), (64 << 20, 60 << 20), Fine),
        ] {
            assert_eq!(shared_memory(usable, space).verdict, verdict, "{space:?}");
        }
        assert_eq!(disk(Some((1 << 40, 1 << 20))).verdict, Problem);
        assert_eq!(disk(Some((1 << 40, 100 << 20))).verdict, CouldBeBetter);
        assert_eq!(disk(Some((1 << 40, 2 << 30))).verdict, Fine);
    }

    #[test]
    fn memory_that_logind_removes_is_reported() {
        let verdict = |running, user, lingers, settings| logout(running, user, lingers, settings).verdict;
        assert_eq!(verdict(true, 1000, false, "#RemoveIPC=no"), CouldBeBetter);
        assert_eq!(verdict(true, 1000, false, "[Login]\nRemoveIPC=no"), Fine);
        assert_eq!(verdict(true, 1000, false, "RemoveIPC=no\nRemoveIPC=yes"), CouldBeBetter);
        for (running, user, lingers) in [(false, 1000, false), (true, 0, false), (true, 1000, true)] {
            assert_eq!(verdict(running, user, lingers, ""), Fine);
        }
    }

    #[test]
    fn domains_are_reported_by_owner() {
        let of = |owner| StaleDomain { domain: "tectum_00000001".into(), owner, files: 3, bytes: 4096 };
        assert_eq!(debris(&[], &[]), Check::fine("debris of runs", "nothing left"));
        let version = DomainOwner::OtherVersion { pids: vec![8] };
        let owned = debris(&[of(DomainOwner::Launcher { pid: Some(7) }), of(version), of(DomainOwner::OtherUser)], &[]);
        let found = "1 of living runs; 1 of living runs of another version; 1 of other users";
        assert_eq!(owned, Check::fine("debris of runs", found));
        let left = debris(&[of(DomainOwner::Nobody)], &[]);
        assert_eq!(
            (left.verdict, left.found.as_str()),
            (CouldBeBetter, "left behind: tectum_00000001 (3 files, 4 KiB)")
        );
        let used = debris(&[of(DomainOwner::Processes { pids: vec![7, 9] })], &[]);
        assert!(used.verdict == CouldBeBetter && used.remedy.unwrap().contains("kill 7, 9"));
        let removed = debris(&[], &[of(DomainOwner::Nobody)]);
        assert_eq!((removed.verdict, removed.found.as_str()), (Fine, "removed tectum_00000001 (3 files, 4 KiB)"));
    }
}
