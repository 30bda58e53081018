//! The emulated chain as a serial port in virtual time: a read steps the clock to the next answer or by the
//! time-out, without sleeping.

use std::io::{self, Read, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use serialport::{ClearBuffer, DataBits, FlowControl, Parity, Result, SerialPort, StopBits};

use super::EmulatedChain;

/// A clock that advances only when it is stepped. Clones share the same time.
#[derive(Debug, Clone, Default)]
pub struct SteppedClock(Arc<AtomicU64>);

impl SteppedClock {
    /// The current time, ns.
    pub fn now(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }

    /// Steps forward to `time`, ns; an earlier time has no effect.
    pub fn step_to(&self, time: u64) {
        self.0.fetch_max(time, Ordering::Relaxed);
    }
}

/// A serial port that is connected to an emulated chain.
#[derive(Debug, Clone)]
pub struct EmulatedPort {
    chain: Arc<Mutex<EmulatedChain>>,
    clock: SteppedClock,
    baud: u32,
    timeout: Duration,
    /// Received bytes that were not read yet.
    ready: Arc<Mutex<Vec<u8>>>,
    /// How often the cable had been pulled out when the port was opened.
    pulled: u64,
}

impl EmulatedPort {
    /// A port to `chain` at `baud`, with the time of `clock`. The caller's own handle of the chain gives access
    /// to its state.
    pub fn new(chain: Arc<Mutex<EmulatedChain>>, clock: SteppedClock, baud: u32) -> Self {
        let pulled = lock(&chain).pulled();
        Self { chain, clock, baud, timeout: Duration::from_millis(10), ready: Arc::default(), pulled }
    }

    /// Fails when the cable is out, or was since the port was opened.
    fn check_cable(&self) -> io::Result<()> {
        let chain = lock(&self.chain);
        if chain.is_cable_out() || chain.pulled() != self.pulled {
            return Err(io::Error::other("the cable is out"));
        }
        Ok(())
    }

    fn collect(&self) {
        let now = self.clock.now();
        let (mut chain, mut ready) = (lock(&self.chain), lock(&self.ready));
        while let Some(bytes) = chain.take(now) {
            ready.extend(bytes);
        }
    }
}

/// Locks also after a panic of another owner, so that a failing test reports its own error.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

impl Read for EmulatedPort {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if buffer.is_empty() {
            return Ok(0);
        }
        self.check_cable()?;
        self.collect();
        if lock(&self.ready).is_empty() {
            let limit = self.clock.now().saturating_add(self.timeout.as_nanos() as u64);
            let next = lock(&self.chain).next_answer().filter(|&due| due <= limit);
            self.clock.step_to(next.unwrap_or(limit));
            self.collect();
        }
        let mut ready = lock(&self.ready);
        if ready.is_empty() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        let n = buffer.len().min(ready.len());
        buffer[..n].copy_from_slice(&ready[..n]);
        ready.drain(..n);
        Ok(n)
    }
}

impl Write for EmulatedPort {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.check_cable()?;
        lock(&self.chain).receive(self.clock.now(), self.baud, bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl SerialPort for EmulatedPort {
    fn name(&self) -> Option<String> {
        Some("emulated".to_owned())
    }

    fn baud_rate(&self) -> Result<u32> {
        Ok(self.baud)
    }

    fn data_bits(&self) -> Result<DataBits> {
        Ok(DataBits::Eight)
    }

    fn flow_control(&self) -> Result<FlowControl> {
        Ok(FlowControl::None)
    }

    fn parity(&self) -> Result<Parity> {
        Ok(Parity::None)
    }

    fn stop_bits(&self) -> Result<StopBits> {
        Ok(StopBits::One)
    }

    fn timeout(&self) -> Duration {
        self.timeout
    }

    fn set_baud_rate(&mut self, baud_rate: u32) -> Result<()> {
        self.baud = baud_rate;
        Ok(())
    }

    fn set_data_bits(&mut self, _: DataBits) -> Result<()> {
        Ok(())
    }

    fn set_flow_control(&mut self, _: FlowControl) -> Result<()> {
        Ok(())
    }

    fn set_parity(&mut self, _: Parity) -> Result<()> {
        Ok(())
    }

    fn set_stop_bits(&mut self, _: StopBits) -> Result<()> {
        Ok(())
    }

    fn set_timeout(&mut self, timeout: Duration) -> Result<()> {
        self.timeout = timeout;
        Ok(())
    }

    fn write_request_to_send(&mut self, _: bool) -> Result<()> {
        Ok(())
    }

    fn write_data_terminal_ready(&mut self, _: bool) -> Result<()> {
        Ok(())
    }

    fn read_clear_to_send(&mut self) -> Result<bool> {
        Ok(true)
    }

    fn read_data_set_ready(&mut self) -> Result<bool> {
        Ok(true)
    }

    fn read_ring_indicator(&mut self) -> Result<bool> {
        Ok(false)
    }

    fn read_carrier_detect(&mut self) -> Result<bool> {
        Ok(true)
    }

    fn bytes_to_read(&self) -> Result<u32> {
        self.collect();
        Ok(lock(&self.ready).len() as u32)
    }

    fn bytes_to_write(&self) -> Result<u32> {
        Ok(0)
    }

    fn clear(&self, which: ClearBuffer) -> Result<()> {
        if which != ClearBuffer::Output {
            self.collect();
            lock(&self.ready).clear();
        }
        Ok(())
    }

    fn try_clone(&self) -> Result<Box<dyn SerialPort>> {
        Ok(Box::new(self.clone()))
    }

    fn set_break(&self) -> Result<()> {
        Ok(())
    }

    fn clear_break(&self) -> Result<()> {
        Ok(())
    }
}
