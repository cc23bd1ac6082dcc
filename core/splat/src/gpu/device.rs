//! Which devices there are, and an open one.
//!
//! `auto` takes the strongest real GPU and never a software adapter; `gpu` takes a software adapter only where there is
//! nothing else. Errors that the driver reports late are kept and come out of the next call that waits.

use std::future::Future;
use std::pin::pin;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::task::{Context, Poll, Waker};

use crate::device::{AdapterReport, Device};
use crate::error::SplatError;

/// The APIs that are looked through.
const BACKENDS: wgpu::Backends = wgpu::Backends::VULKAN.union(wgpu::Backends::METAL).union(wgpu::Backends::DX12);

/// Raised when kernels, or what a device is given to do, change the bits of results: records of before are not found then.
const KERNELS: u32 = 2;

/// The machine's adapters, those that are preferred first.
pub fn adapters() -> Vec<AdapterReport> {
    let mut reports: Vec<AdapterReport> = ranked().iter().map(report).collect();
    if let Some(first) = reports.iter_mut().find(|adapter| adapter.suits(Device::Auto)) {
        first.is_automatic = true;
    }
    reports
}

/// An open device with its kernels; shared by all that render on it.
pub struct Gpu {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    pub(crate) limits: wgpu::Limits,
    pub(crate) programs: Mutex<super::program::Programs>,
    report: AdapterReport,
    failure: Arc<Mutex<Option<String>>>,
}

impl std::fmt::Debug for Gpu {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Gpu").field("report", &self.report).finish_non_exhaustive()
    }
}

impl Gpu {
    /// Opens what `device` asks for; nothing where that is the CPU.
    ///
    /// # Errors
    /// When a GPU is asked for and there is none, or it cannot be opened.
    pub fn open(device: Device) -> Result<Option<Arc<Self>>, SplatError> {
        if device == Device::Cpu {
            return Ok(None);
        }
        match ranked().into_iter().find(|adapter| report(adapter).suits(device)) {
            Some(adapter) => Self::from_adapter(&adapter).map(|gpu| Some(Arc::new(gpu))),
            None if device == Device::Auto => Ok(None),
            None => Err(SplatError::Device(
                "no GPU was found: neither Vulkan, Metal nor Direct3D 12 offers a usable adapter; install the \
                 graphics driver (`heartian devices` lists what is seen), or run with --device cpu"
                    .to_owned(),
            )),
        }
    }

    /// What `device` comes to on this machine where that is not the CPU: a name for the arithmetic that results depend on.
    pub fn numerics(device: Device) -> Option<String> {
        static ADAPTERS: OnceLock<Vec<AdapterReport>> = OnceLock::new();
        if device == Device::Cpu {
            return None;
        }
        let adapter = ADAPTERS.get_or_init(adapters).iter().find(|adapter| adapter.suits(device))?;
        Some(format!("{} {} {}, kernels {KERNELS}", adapter.backend, adapter.name, adapter.driver))
    }

    fn from_adapter(adapter: &wgpu::Adapter) -> Result<Self, SplatError> {
        let report = report(adapter);
        let limits = wanted_limits(adapter);
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("heartian"),
            required_limits: limits.clone(),
            memory_hints: wgpu::MemoryHints::Performance,
            ..Default::default()
        };
        let refused = |reason: String| {
            SplatError::Device(format!("{} cannot be opened: {reason}; run with --device cpu", report.name))
        };
        let opened = at_once(adapter.request_device(&descriptor));
        let (device, queue) =
            opened.ok_or_else(|| refused("it does not answer".into()))?.map_err(|e| refused(e.to_string()))?;
        let failure = Arc::new(Mutex::new(None));
        let keep = |failure: &Arc<Mutex<Option<String>>>, message: String| {
            failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(message);
        };
        let kept = Arc::clone(&failure);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            let message = match error {
                wgpu::Error::OutOfMemory { .. } => "its memory does not suffice; take fewer Gaussians, a smaller \
                                                    picture, or --device cpu"
                    .to_owned(),
                other => format!("it refused a command: {other}"),
            };
            keep(&kept, message);
        }));
        let kept = Arc::clone(&failure);
        device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                keep(&kept, format!("it was lost ({message}); run again, or with --device cpu"));
            }
        });
        Ok(Self { device, queue, limits, programs: Mutex::default(), report, failure })
    }

    /// What this is.
    pub fn report(&self) -> &AdapterReport {
        &self.report
    }

    /// An error about this device.
    pub(crate) fn error(&self, reason: impl std::fmt::Display) -> SplatError {
        SplatError::Device(format!("{}: {reason}", self.report.name))
    }

    /// Whether all went well so far.
    ///
    /// # Errors
    /// When the device was lost, ran out of memory, or refused a command.
    pub fn check(&self) -> Result<(), SplatError> {
        match self.failure.lock().unwrap_or_else(PoisonError::into_inner).as_ref() {
            None => Ok(()),
            Some(reason) => Err(self.error(reason)),
        }
    }

    /// Waits until all that was submitted is done.
    ///
    /// # Errors
    /// As [`Gpu::check`].
    pub fn wait(&self) -> Result<(), SplatError> {
        self.poll(wgpu::PollType::wait_indefinitely())
    }

    /// Waits until a submission is done.
    ///
    /// # Errors
    /// As [`Gpu::check`].
    pub(crate) fn wait_for(&self, submission: wgpu::SubmissionIndex) -> Result<(), SplatError> {
        self.poll(wgpu::PollType::Wait { submission_index: Some(submission), timeout: None })
    }

    fn poll(&self, how: wgpu::PollType) -> Result<(), SplatError> {
        let polled = self.device.poll(how);
        self.check()?;
        polled.map(|_| ()).map_err(|e| self.error(format!("it does not finish: {e}")))
    }
}

/// The adapters, discrete GPUs first and software last; order is the driver's among equals.
fn ranked() -> Vec<wgpu::Adapter> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: BACKENDS,
        flags: wgpu::InstanceFlags::empty(),
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    let mut found = at_once(instance.enumerate_adapters(BACKENDS)).unwrap_or_default();
    found.sort_by_key(|adapter| match adapter.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    });
    found
}

fn report(adapter: &wgpu::Adapter) -> AdapterReport {
    let (info, limits) = (adapter.get_info(), adapter.limits());
    let kind = match info.device_type {
        wgpu::DeviceType::DiscreteGpu => "discrete",
        wgpu::DeviceType::IntegratedGpu => "integrated",
        wgpu::DeviceType::VirtualGpu => "virtual",
        wgpu::DeviceType::Cpu => "software",
        wgpu::DeviceType::Other => "other",
    };
    AdapterReport {
        name: info.name,
        backend: info.backend.to_string(),
        kind,
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
        largest_binding: limits.max_storage_buffer_binding_size.min(limits.max_buffer_size),
        workgroups: limits.max_compute_workgroups_per_dimension,
        is_software: info.device_type == wgpu::DeviceType::Cpu,
        is_usable: wgpu::Limits::default().check_limits(&limits)
            && adapter.get_downlevel_capabilities().flags.contains(wgpu::DownlevelFlags::COMPUTE_SHADERS),
        is_automatic: false,
    }
}

/// What every WebGPU device grants, with buffers as large as this one can have.
fn wanted_limits(adapter: &wgpu::Adapter) -> wgpu::Limits {
    let own = adapter.limits();
    wgpu::Limits {
        max_storage_buffer_binding_size: own.max_storage_buffer_binding_size,
        max_buffer_size: own.max_buffer_size,
        ..wgpu::Limits::default()
    }
}

/// The value of a future that is ready at once, as all of wgpu's are outside a browser.
pub(crate) fn at_once<T>(future: impl Future<Output = T>) -> Option<T> {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(value) => Some(value),
        Poll::Pending => None,
    }
}
